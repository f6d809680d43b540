"""Pipeline: components and rules, chosen by name or in a TOML file."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from numbers import Integral
from pathlib import Path
from typing import Any, Literal

import numpy as np

from agglo_core.agglomeration.choices import POLISH, Choice, new_run, short_name
from agglo_core.agglomeration.constraints import bounded_goals, constrained, naming
from agglo_core.agglomeration.enforcing import part_rules
from agglo_core.agglomeration.goals import TARGETS, CountGoal, Goal, Numbers, check_targets, resolve_goals
from agglo_core.agglomeration.lines import line_levels
from agglo_core.agglomeration.ordered_levels import ordered_levels
from agglo_core.agglomeration.polishing import PostPass
from agglo_core.agglomeration.recursion import warn_of_large_cells
from agglo_core.agglomeration.rules import Rules, imbalance
from agglo_core.agglomeration.run import Run
from agglo_core.agglomeration.run_file import RunFile
from agglo_core.arrays import Int, frozen_int, trusted
from agglo_core.constraints.metric import in_metric
from agglo_core.errors import OptionError
from agglo_core.graph import Graph
from agglo_core.hierarchy import Hierarchy
from agglo_core.mesh import Mesh
from agglo_core.progress import Listener, followed, phase
from agglo_core.registry import Registry, default
from agglo_core.threads import thread_count, using_threads

Method = Literal["recursive", "kway"]


@dataclass(frozen=True)
class Pipeline(Rules):
    """The components and targets of a run; names are looked up when it starts.

    Attributes
    ----------
    bisector : Choice
        What splits a piece.
    fixer : Choice
        What makes both sides connected.
    refiners : sequence of Choice
        What shortens the interface of each split, in this order.
    method : "recursive" or "kway"
        ``kway`` needs a bisector that implements ``partition``.
    nested : bool
        Whether each level must be a coarsening of the one before.
    merge : bool
        Size targets: merge neighbouring parts while their union meets the target.
    polish : bool
        Whether ``post_refiners`` work on each finished level.
    post_refiners : sequence of Choice
        What moves cells between finished parts; moves that make a part miss its size are undone.
    seed : int
        Root of all random numbers.
    h_star, h_factor, n_parts, cells_per_part : number or sequence, optional
        One kind of target; ``h_factor=(2, 4, 8)`` if none is given.

    Constraints, by keyword or as components: see :class:`~agglo_core.agglomeration.rules.Rules`.

    Examples
    --------
    >>> pipeline = agglo.Pipeline(bisector="inertial", n_parts=(8, 2))
    >>> pipeline.run(agglo.samples.squares(8)).parts
    [8, 2]
    """

    bisector: Choice = "kmeans"
    refiners: Sequence[Choice] = ("interface",)
    fixer: Choice = "connectivity"
    method: Method = "recursive"
    nested: bool = True
    merge: bool = False
    polish: bool = True
    post_refiners: Sequence[Choice] = POLISH
    seed: int = 0
    h_star: Numbers | None = None
    h_factor: Numbers | None = None
    n_parts: Numbers | None = None
    cells_per_part: Numbers | None = None

    def __post_init__(self) -> None:
        if self.method not in ("recursive", "kway"):
            raise OptionError(f"method must be 'recursive' or 'kway', given {self.method!r}")
        if not isinstance(self.seed, Integral) or isinstance(self.seed, bool) or not 0 <= self.seed < 2**63:
            raise OptionError(f"seed must be an integer in 0..2^63 − 1, given {self.seed!r}")
        object.__setattr__(self, "seed", int(self.seed))
        for name in ("nested", "merge", "polish"):
            if not isinstance(getattr(self, name), bool):
                raise OptionError(f"{name} must be true or false, given {getattr(self, name)!r}")
        if self.merge and (self.n_parts is not None or self.cells_per_part is not None):
            raise OptionError("merge works on size targets; counts are met exactly without it")
        for name in ("refiners", "post_refiners"):
            value = getattr(self, name)
            if isinstance(value, str) or not isinstance(value, Sequence):
                raise OptionError(f"{name} must be a sequence of components, given {value!r}")
        self.check_rules()

    @classmethod
    def from_toml(cls, path: str | os.PathLike[str], *, allow_code: bool = False) -> Pipeline:
        """Pipeline from a TOML file with the attributes as keys.

        A component is a name, or a table with ``name`` and its options. Options that name code to import are
        refused when the run starts, unless ``allow_code`` says that the file is trusted.

        Raises
        ------
        FileError
            If the file cannot be read or parsed, or has an unknown key.
        OptionError
            If a value does not fit its key; names the file.
        """
        known = [each.name for each in sorted(fields(cls), key=lambda each: bool(each.kw_only))]
        base, file = cls(), RunFile(Path(path), known, allow_code=allow_code)
        try:
            check_targets({name: file.read(name, None) for name in TARGETS})
            return cls(**{name: file.read(name, getattr(base, name)) for name in known})
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
        """Agglomerate ``mesh``, with names looked up in ``registry``; see :func:`~agglo_core.agglomerate`."""
        count = thread_count() if threads is None else threads  # the environment is asked once
        with followed(progress, verbose) as listen, using_threads(count):
            return self._hierarchy(mesh, default() if registry is None else registry, listen)

    def _hierarchy(self, mesh: Mesh | Graph, registry: Registry, listen: Listener | None) -> Hierarchy:
        with phase(listen, "building the graph"):
            graph = mesh.graph if isinstance(mesh, Mesh) else mesh
        members = self.members(mesh, graph, registry)
        there = graph if self.metric is None else in_metric(mesh, graph, self.metric)
        allowed = constrained(graph, members, there)
        goals = bounded_goals(graph, allowed, members, self._goals(mesh, there, allowed))
        run = self.new_run(registry, listen)
        post = PostPass(self.merge, bool(run.post_refiners), part_rules(graph, members))
        counts = isinstance(goals[0], CountGoal)
        usable = self.balanced(allowed, counts=counts)
        make = line_levels if self.lines else ordered_levels
        with naming(members):
            levels = make(usable, goals, run, post, kway=self.method == "kway", nested=self.nested)
        warn_of_large_cells(goals, run)
        told: dict[str, Any] = {"bisector": short_name(self.bisector), "method": self.method}
        if counts:
            mass = None if self.weights is None and self.balance in (None, "cells") else self.mass(graph)
            told["imbalance"] = [imbalance(mass, labels) for labels in levels]
        return trusted(
            Hierarchy,
            mesh if isinstance(mesh, Mesh) else None,
            graph,
            tuple(levels),
            [goal.record(int(labels.max()) + 1) for goal, labels in zip(goals, levels, strict=True)],
            self.nested or len(levels) == 1,
            run.statistics.told() | told,
        )

    def new_run(self, registry: Registry, progress: Listener | None = None) -> Run:
        """A run of these components, looked up in ``registry``, which tells of its progress."""
        return new_run(
            registry,
            kway=self.method == "kway",
            bisector=self.bisector,
            refiners=self.refiners,
            post_refiners=self.post_refiners if self.polish else (),
            fixer=self.fixer,
            seed=self.seed,
            progress=progress,
        )

    def goals(
        self, n_cells: int, mesh_size: Callable[[], float], components: Callable[[], Int]
    ) -> tuple[Goal, ...]:
        """The goals on a mesh of so many cells, finest first: see :func:`~.goals.resolve_goals`."""
        return resolve_goals(
            n_cells,
            mesh_size,
            h_star=self.h_star,
            h_factor=self.h_factor,
            n_parts=self.n_parts,
            cells_per_part=self.cells_per_part,
            components=components,
        )

    def _goals(self, mesh: Mesh | Graph, graph: Graph, allowed: Graph) -> tuple[Goal, ...]:
        def mesh_size() -> float:
            if isinstance(mesh, Mesh) and self.metric is None:
                return mesh.h
            return float(graph.part_diameters(np.arange(graph.n)).max())

        return self.goals(graph.n, mesh_size, lambda: frozen_int(np.bincount(allowed.components())))
