"""Pipeline: a run configuration with components and rules, from keywords or a TOML file."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from numbers import Integral
from pathlib import Path
from typing import Any

import numpy as np

from agglo_core.agglomeration.choices import new_run, require_points, short_name
from agglo_core.agglomeration.goals import CountGoal, Goal, check_targets, resolve_goals
from agglo_core.agglomeration.keywords import METHODS, SIZES, TARGETS
from agglo_core.agglomeration.levels.lines import line_levels
from agglo_core.agglomeration.levels.ordered import compute_levels
from agglo_core.agglomeration.levels.polishing import PostPass
from agglo_core.agglomeration.levels.recursion import note_repeated_levels, warn_of_large_cells
from agglo_core.agglomeration.rules.edges import naming_constraints, raise_counts, remove_forbidden_edges
from agglo_core.agglomeration.rules.members import Rules, imbalance
from agglo_core.agglomeration.rules.parts import part_rules
from agglo_core.agglomeration.run_file import read_run_file
from agglo_core.arrays import Int, frozen_int, trusted
from agglo_core.constraints.metric import in_metric
from agglo_core.errors import OptionError
from agglo_core.graph import Graph
from agglo_core.hierarchy import Hierarchy
from agglo_core.mesh import Mesh
from agglo_core.progress import Listener, followed, phase
from agglo_core.registry import Registry, default
from agglo_core.suggestions import suggest_keywords
from agglo_core.threads import thread_count, using_threads


@suggest_keywords()
@dataclass(frozen=True)
class Pipeline(Rules):
    """Configuration of an agglomeration run: components, targets and rules.

    Names are looked up when the run starts. The parameters are the keywords of
    :func:`~agglo_core.agglomerate` that define the result, from ``bisector`` to ``lines``, with equal meaning
    and defaults. Parameters up to ``cells_per_part`` in the signature may be positional.

    Examples
    --------
    >>> pipeline = agglo.Pipeline(bisector="inertial", n_parts=(8, 2))
    >>> pipeline.run(agglo.samples.squares(8)).parts
    [8, 2]
    """

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise OptionError(
                f"method must be 'recursive' or 'kway', given {self.method!r}; bisector= is the algorithm"
            )
        if not isinstance(self.seed, Integral) or isinstance(self.seed, bool) or not 0 <= self.seed < 2**63:
            raise OptionError(f"seed must be an integer in 0..2^63 − 1, given {self.seed!r}")
        object.__setattr__(self, "seed", int(self.seed))
        for name in ("nested", "merge", "polish"):
            if not isinstance(getattr(self, name), bool):
                raise OptionError(f"{name} must be true or false, given {getattr(self, name)!r}")
        for name in ("refiners", "post_refiners"):
            value = getattr(self, name)
            if isinstance(value, str) or not isinstance(value, Sequence):
                raise OptionError(f"{name} must be a sequence of components, given {value!r}")
        self.check_rules()

    @classmethod
    def from_toml(cls, path: str | os.PathLike[str], *, allow_code: bool = False) -> Pipeline:
        """Create a pipeline from a TOML file with the attributes as keys.

        A component is a name, or a table with ``name`` and its options. A run refuses options that name code
        to import, unless ``allow_code`` marks the file as trusted.

        Raises
        ------
        FileError
            If the file cannot be read or parsed, or has an unknown key.
        OptionError
            If a value does not fit its key. The message names the file.
        """
        keywords = read_run_file(Path(path), allow_code=allow_code)
        try:
            check_targets({name: keywords.get(name) for name in TARGETS})
            return cls(**keywords)
        except OptionError as error:
            raise OptionError(f"{path}: {error}") from error

    def run(
        self,
        mesh: Mesh | Graph,
        registry: Registry | None = None,
        progress: Listener | None = None,
        verbose: bool = False,
        threads: int | None = None,
    ) -> Hierarchy:
        """Agglomerate ``mesh`` with components from ``registry`` (see :func:`~agglo_core.agglomerate`)."""
        count = thread_count() if threads is None else threads  # read the environment once
        with followed(progress, verbose) as listen, using_threads(count):
            return self._hierarchy(mesh, default() if registry is None else registry, listen)

    def _hierarchy(self, mesh: Mesh | Graph, registry: Registry, listen: Listener | None) -> Hierarchy:
        """Agglomerate ``mesh``: build the graph, apply metric and constraints, and compute the levels."""
        # 1. Graph of the mesh, measured in the metric, without forbidden edges.
        with phase(listen, "building the graph"):
            graph = mesh.graph if isinstance(mesh, Mesh) else mesh
        members = self.members(mesh, graph, registry)
        metric_graph = graph if self.metric is None else in_metric(mesh, graph, self.metric)
        rule_graph = remove_forbidden_edges(graph, members, metric_graph)
        # 2. Components, goals and post-passes of the run.
        run = new_run(self, registry, listen)
        if not isinstance(mesh, Mesh):
            require_points(graph, self, run)
        goals = raise_counts(graph, rule_graph, members, self._goals(mesh, metric_graph, rule_graph))
        post = PostPass(self.merge, bool(run.post_refiners), part_rules(graph, members))
        counts = isinstance(goals[0], CountGoal)
        # 3. Loads by which counts are distributed, then the levels.
        loaded = self.balanced(rule_graph, counts=counts)
        make_levels = line_levels if self.lines else compute_levels
        with naming_constraints(members):
            levels = make_levels(loaded, goals, run, post, kway=self.method == "kway", nested=self.nested)
        warn_of_large_cells(goals, run)
        parts = [int(labels.max()) + 1 for labels in levels]
        note_repeated_levels(goals, parts)
        # 4. Statistics and the hierarchy.
        statistics: dict[str, Any] = {"bisector": short_name(self.bisector), "method": self.method}
        if counts:
            mass = None if self.weights is None and self.balance in (None, "cells") else self.mass(graph)
            statistics["imbalance"] = [imbalance(mass, labels) for labels in levels]
        return trusted(
            Hierarchy,
            mesh if isinstance(mesh, Mesh) else None,
            graph,
            tuple(levels),
            [goal.record(count) for goal, count in zip(goals, parts, strict=True)],
            self.nested or len(levels) == 1,
            run.statistics.as_dict() | statistics,
        )

    def goals(
        self, n_cells: int, mesh_size: Callable[[], float], components: Callable[[], Int]
    ) -> tuple[Goal, ...]:
        """Return the levels' goals for ``n_cells`` cells, finest first (:func:`~.goals.resolve_goals`).

        Raises
        ------
        OptionError
            If a target is invalid, or ``merge`` is set without a size.
        """
        if self.merge and all(getattr(self, name) is None for name in SIZES):
            raise OptionError("merge applies to sizes only: give h_star or h_factor, or pass merge=False")
        return resolve_goals(
            n_cells,
            mesh_size,
            components=components,
            **{name: getattr(self, name) for name in TARGETS},
        )

    def _goals(self, mesh: Mesh | Graph, graph: Graph, rule_graph: Graph) -> tuple[Goal, ...]:
        def mesh_size() -> float:
            if isinstance(mesh, Mesh) and self.metric is None:
                return mesh.h
            return float(graph.part_diameters(np.arange(graph.n)).max())

        return self.goals(graph.n, mesh_size, lambda: frozen_int(np.bincount(rule_graph.components())))
