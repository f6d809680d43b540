"""Pipeline: chosen components, from names or a TOML file, and what they do to a mesh."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from numbers import Integral
from pathlib import Path
from typing import Any, Literal

from agglo_core.agglomeration.choices import (
    Choice,
    choice_from_table,
    fallback_member,
    member,
    short_name,
)
from agglo_core.agglomeration.kway import kway_levels
from agglo_core.agglomeration.polishing import PostPass
from agglo_core.agglomeration.recursion import recursive_levels
from agglo_core.agglomeration.run import Crew
from agglo_core.agglomeration.targets import Levels, Numbers, resolve_targets
from agglo_core.arrays import Int, frozen_int
from agglo_core.errors import FileError, OptionError
from agglo_core.graph import Graph
from agglo_core.graph.ordering import curve_order
from agglo_core.hierarchy import Hierarchy, by_first_cell
from agglo_core.mesh import Mesh
from agglo_core.protocols import Bisector, LevelBisector, Partitioner
from agglo_core.registry import default

__all__ = ["Choice", "Pipeline", "agglomerate"]

Method = Literal["recursive", "kway"]


@dataclass(frozen=True)
class Pipeline:
    """The components of a run; names are looked up when it starts.

    Attributes
    ----------
    bisector, fixer : Choice
    refiners : sequence of Choice
        Applied in this order.
    method : "recursive" or "kway"
        ``kway`` needs a bisector that implements ``partition``.
    nested : bool
        Whether each level must be a coarsening of the one before.
    merge : bool
        Size targets: merge neighbouring parts while their union meets the target.
    post_refiners : sequence of Choice
        Applied to each finished level; moves that make a part miss its size are taken back.
    seed : int
        Root of all random numbers.
    h_star, h_factor, n_parts, cells_per_part : number or sequence, optional
        One kind of target; ``h_factor=(2, 4, 8)`` if none is given.
    """

    bisector: Choice = "kmeans"
    refiners: Sequence[Choice] = ("interface",)
    fixer: Choice = "connectivity"
    method: Method = "recursive"
    nested: bool = True
    merge: bool = False
    post_refiners: Sequence[Choice] = ()
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
        for name in ("nested", "merge"):
            if not isinstance(getattr(self, name), bool):
                raise OptionError(f"{name} must be true or false, given {getattr(self, name)!r}")
        if self.merge and (self.n_parts is not None or self.cells_per_part is not None):
            raise OptionError("merge works on size targets; counts are met exactly without it")
        for name in ("refiners", "post_refiners"):
            value = getattr(self, name)
            if isinstance(value, str) or not isinstance(value, Sequence):
                raise OptionError(f"{name} must be a sequence of components, given {value!r}")

    @classmethod
    def from_toml(cls, path: str | os.PathLike[str]) -> Pipeline:
        """Pipeline from a TOML file with the attributes as keys.

        A component is a name, or a table with ``name`` and its options.

        Raises
        ------
        FileError
            If the file cannot be read or parsed, or has an unknown key.
        """
        file = Path(path)
        try:
            table = tomllib.loads(file.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise FileError(f"{file}: {error}") from None
        known = [each.name for each in fields(cls)]
        unknown = sorted(set(table) - set(known))
        if unknown:
            raise FileError(f"{file}: unknown key {unknown[0]!r}; accepted: {', '.join(known)}")
        chosen = dict(table)
        for key in ("bisector", "fixer"):
            if key in chosen:
                chosen[key] = choice_from_table(file, key, chosen[key])
        for key in ("refiners", "post_refiners"):
            if key in chosen:
                if not isinstance(chosen[key], list):
                    raise FileError(f"{file}: {key} must be a list")
                chosen[key] = tuple(choice_from_table(file, key, each) for each in chosen[key])
        return cls(**chosen)

    def run(self, mesh: Mesh | Graph) -> Hierarchy:
        """Agglomerate ``mesh``; see :func:`agglomerate`."""
        graph = mesh.graph if isinstance(mesh, Mesh) else mesh
        graph.ensure_sound()
        h0 = mesh.h if isinstance(mesh, Mesh) and self._needs_mesh_size() else None
        levels = resolve_targets(
            graph,
            h0,
            h_star=self.h_star,
            h_factor=self.h_factor,
            n_parts=self.n_parts,
            cells_per_part=self.cells_per_part,
        )
        crew = self._crew()
        with crew.statistics.timed("order"):
            order = curve_order(graph.centroids)
            ordered = graph.subgraph(order, frozen_int([0, graph.n]))
        result = self._levels(ordered, levels, crew)
        labels = []
        for each in result:
            given = each.copy()
            given[order] = each
            labels.append(by_first_cell(given))
        return Hierarchy(
            mesh if isinstance(mesh, Mesh) else None,
            graph,
            labels,
            levels.asked,
            self.nested or len(labels) == 1,
            asdict(crew.statistics) | {"bisector": short_name(self.bisector), "method": self.method},
        )

    def _needs_mesh_size(self) -> bool:
        others = (self.h_star, self.n_parts, self.cells_per_part)
        return all(value is None for value in others)

    def _levels(self, graph: Graph, levels: Levels, crew: Crew) -> list[Int]:
        post = PostPass(self.merge, bool(self.post_refiners))
        if self.method == "kway":
            return kway_levels(graph, levels, self.nested, crew, post)
        if self.nested:
            return recursive_levels(graph, levels, crew, post)
        alone = levels.one_by_one()
        return [recursive_levels(graph, each, crew, post)[0] for each in alone]

    def _crew(self) -> Crew:
        bisector, fallback = member("bisector", self.bisector)
        tool = bisector.tool
        bisects = isinstance(tool, LevelBisector | Bisector)
        if self.method == "kway" and not isinstance(tool, Partitioner):
            raise OptionError(f"{bisector.title} has no k-way partition; use method='recursive'")
        if self.method == "recursive" and not bisects:
            raise OptionError(f"{bisector.title} cannot bisect; use method='kway'")
        return Crew(
            bisector=bisector,
            refiners=[member("refiner", choice)[0] for choice in self.refiners],
            post_refiners=[member("refiner", choice)[0] for choice in self.post_refiners],
            fixer=member("fixer", self.fixer)[0],
            finisher=bisector if bisects else member("bisector", "inertial")[0],
            fallback=fallback_member(bisector, fallback),
            watch=default().level_done,
            seed=self.seed,
        )


def agglomerate(
    mesh: Mesh | Graph,
    *,
    bisector: Choice | None = None,
    h_star: Numbers | None = None,
    h_factor: Numbers | None = None,
    n_parts: Numbers | None = None,
    cells_per_part: Numbers | None = None,
    method: Method | None = None,
    nested: bool | None = None,
    refiners: Sequence[Choice] | None = None,
    fixer: Choice | None = None,
    merge: bool | None = None,
    post_refiners: Sequence[Choice] | None = None,
    seed: int | None = None,
    config: str | os.PathLike[str] | None = None,
) -> Hierarchy:
    """Agglomerate a mesh or graph into a hierarchy of coarse levels (paper, Algorithm 1).

    Parameters
    ----------
    mesh : Mesh or Graph
    bisector, fixer : str, (str, options) or component object, optional
        Default ``"kmeans"`` and ``"connectivity"``.
    h_star, h_factor, n_parts, cells_per_part : number or sequence, optional
        One kind of target, a level for each value: largest diameter, the same in units of the mesh
        size h0, exact number of parts, mean number of cells. Default ``h_factor=(2, 4, 8)``.
    method : "recursive" or "kway", optional
    nested : bool, optional
        Default True.
    refiners : sequence of components, optional
        Default ``("interface",)``; ``()`` for none.
    merge : bool, optional
        Size targets: merge neighbouring parts while their union meets the target. Default False.
    post_refiners : sequence of components, optional
        Applied to each finished level; moves that make a part miss its size are taken back. Default
        ``()``.
    seed : int, optional
        Default 0.
    config : path, optional
        TOML file with these names as keys; arguments given here win.

    Returns
    -------
    Hierarchy
        Every part connected; in size mode with ``diam <= h_star``, but for single cells that are
        larger (counted in ``statistics``).

    Raises
    ------
    OptionError
        If targets or options make no sense.
    PluginError
        If a component is missing, unusable, or misbehaves.
    """
    if not isinstance(mesh, Mesh | Graph):
        raise OptionError(f"agglomerate needs a Mesh or a Graph, given {type(mesh).__name__}")
    pipeline = Pipeline() if config is None else Pipeline.from_toml(config)
    targets: dict[str, Any] = {
        "h_star": h_star,
        "h_factor": h_factor,
        "n_parts": n_parts,
        "cells_per_part": cells_per_part,
    }
    if any(value is not None for value in targets.values()):
        counts = n_parts is not None or cells_per_part is not None
        pipeline = replace(pipeline, **targets, merge=pipeline.merge and not counts)
    rest: dict[str, Any] = {
        "bisector": bisector,
        "method": method,
        "nested": nested,
        "refiners": refiners,
        "fixer": fixer,
        "merge": merge,
        "post_refiners": post_refiners,
        "seed": seed,
    }
    return replace(pipeline, **{key: value for key, value in rest.items() if value is not None}).run(mesh)
