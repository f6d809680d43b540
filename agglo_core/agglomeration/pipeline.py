"""Pipeline: components chosen by name or in a TOML file, and :func:`agglomerate`, which runs them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from numbers import Integral
from pathlib import Path
from typing import Literal, TypeVar

from agglo_core.agglomeration.choices import POLISH, Choice, chosen, new_run, short_name
from agglo_core.agglomeration.constraints import constrained
from agglo_core.agglomeration.goals import TARGETS, Goal, Numbers, check_targets, resolve_goals
from agglo_core.agglomeration.ordered_levels import ordered_levels
from agglo_core.agglomeration.polishing import PostPass
from agglo_core.agglomeration.recursion import warn_of_large_cells
from agglo_core.agglomeration.run_file import RunFile
from agglo_core.errors import OptionError
from agglo_core.graph import Graph
from agglo_core.hierarchy import Hierarchy
from agglo_core.mesh import Mesh
from agglo_core.progress import Listener, followed, phase
from agglo_core.registry import Registry, default
from agglo_core.threads import using_threads

__all__ = ["Choice", "Pipeline", "agglomerate"]

Method = Literal["recursive", "kway"]
_T = TypeVar("_T")


@dataclass(frozen=True)
class Pipeline:
    """The components and targets of a run; names are looked up when it starts.

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
    polish : bool
        Whether ``post_refiners`` work on each finished level.
    post_refiners : sequence of Choice
        Moves that make a part miss its size are undone.
    seed : int
        Root of all random numbers.
    h_star, h_factor, n_parts, cells_per_part : number or sequence, optional
        One kind of target; ``h_factor=(2, 4, 8)`` if none is given.
    constraints : sequence of Choice
        No part is joined across an edge that one of them forbids.
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
    constraints: Sequence[Choice] = ()

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
        for name in ("refiners", "post_refiners", "constraints"):
            value = getattr(self, name)
            if isinstance(value, str) or not isinstance(value, Sequence):
                raise OptionError(f"{name} must be a sequence of components, given {value!r}")

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
        known = [each.name for each in fields(cls)]
        base, file = cls(), RunFile(Path(path), known, allow_code=allow_code)
        try:
            check_targets({name: file.value(name, None) for name in TARGETS})
            return cls(
                bisector=file.component("bisector", base.bisector),
                refiners=file.components("refiners", base.refiners),
                fixer=file.component("fixer", base.fixer),
                method=file.value("method", base.method),
                nested=file.value("nested", base.nested),
                merge=file.value("merge", base.merge),
                polish=file.value("polish", base.polish),
                post_refiners=file.components("post_refiners", base.post_refiners),
                seed=file.value("seed", base.seed),
                h_star=file.value("h_star", base.h_star),
                h_factor=file.value("h_factor", base.h_factor),
                n_parts=file.value("n_parts", base.n_parts),
                cells_per_part=file.value("cells_per_part", base.cells_per_part),
                constraints=file.components("constraints", base.constraints),
            )
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
        """Agglomerate ``mesh``, with names looked up in ``registry``; see :func:`agglomerate`."""
        with followed(progress, verbose) as listen, using_threads(threads):
            return self._hierarchy(mesh, default() if registry is None else registry, listen)

    def _hierarchy(self, mesh: Mesh | Graph, registry: Registry, listen: Listener | None) -> Hierarchy:
        with phase(listen, "building the graph"):
            graph = mesh.graph if isinstance(mesh, Mesh) else mesh
            graph.ensure_valid()
        goals = self._goals(mesh, graph)
        run = new_run(
            registry,
            kway=self.method == "kway",
            bisector=self.bisector,
            refiners=self.refiners,
            post_refiners=self.post_refiners if self.polish else (),
            fixer=self.fixer,
            seed=self.seed,
            progress=listen,
        )
        members = [chosen("constraint", each, registry)[0] for each in self.constraints]
        post = PostPass(self.merge, bool(run.post_refiners))
        usable = constrained(graph, members, goals)
        levels = ordered_levels(usable, goals, run, post, kway=self.method == "kway", nested=self.nested)
        warn_of_large_cells(goals, run)
        return Hierarchy(
            mesh if isinstance(mesh, Mesh) else None,
            graph,
            levels,
            [goal.asked for goal in goals],
            self.nested or len(levels) == 1,
            asdict(run.statistics) | {"bisector": short_name(self.bisector), "method": self.method},
        )

    def _goals(self, mesh: Mesh | Graph, graph: Graph) -> tuple[Goal, ...]:
        in_mesh_sizes = self.h_star is None and self.n_parts is None and self.cells_per_part is None
        return resolve_goals(
            graph,
            mesh.h if in_mesh_sizes and isinstance(mesh, Mesh) else None,
            h_star=self.h_star,
            h_factor=self.h_factor,
            n_parts=self.n_parts,
            cells_per_part=self.cells_per_part,
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
    polish: bool | None = None,
    post_refiners: Sequence[Choice] | None = None,
    seed: int | None = None,
    config: str | os.PathLike[str] | None = None,
    constraints: Sequence[Choice] | None = None,
    registry: Registry | None = None,
    allow_code: bool = False,
    progress: Listener | None = None,
    verbose: bool = False,
    threads: int | None = None,
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
    polish : bool, optional
        Whether ``post_refiners`` work on each finished level. Default True.
    post_refiners : sequence of components, optional
        Moves that make a part miss its size are undone. Default ``("compactness",)``.
    seed : int, optional
        Default 0.
    config : path, optional
        TOML file with these names as keys; arguments given here take precedence.
    constraints : sequence of components, optional
        No part is joined across an edge of the dual graph that one of them forbids. Default ``()``.
    registry : Registry, optional
        Where names are looked up, and whose plugins follow the run; by default the installed ones.
    allow_code : bool, optional
        Whether options in ``config`` may name code, which is then imported and run. Default False.
    progress : callable, optional
        Told of each phase, and how much of it is done: an :class:`~agglo_core.progress.Progress`, at most
        20 times a second. What it raises ends the run and passes through unchanged.
    verbose : bool, optional
        Show the same on stderr: a bar on a terminal, else lines.
    threads : int, optional
        How many threads may work at a time; the result does not depend on it. Default: the environment
        variable ``AGGLO_THREADS``, else 1.

    Returns
    -------
    Hierarchy
        Every part connected; in size mode with ``diam <= h_star``, except single cells that are
        larger (counted in ``statistics``).

    Raises
    ------
    OptionError
        If targets or options make no sense, or contradict the constraints.
    PluginError
        If a component is missing, unusable, or misbehaves.
    """
    if not isinstance(mesh, Mesh | Graph):
        raise OptionError(f"agglomerate needs a Mesh or a Graph, given {type(mesh).__name__}")
    base = Pipeline() if config is None else Pipeline.from_toml(config, allow_code=allow_code)
    counts = n_parts is not None or cells_per_part is not None
    own = counts or h_star is not None or h_factor is not None  # a target given replaces those of the file
    return Pipeline(
        bisector=_given(bisector, base.bisector),
        refiners=_given(refiners, base.refiners),
        fixer=_given(fixer, base.fixer),
        method=_given(method, base.method),
        nested=_given(nested, base.nested),
        merge=_given(merge, base.merge and not counts),
        polish=_given(polish, base.polish),
        post_refiners=_given(post_refiners, base.post_refiners),
        seed=_given(seed, base.seed),
        h_star=h_star if own else base.h_star,
        h_factor=h_factor if own else base.h_factor,
        n_parts=n_parts if own else base.n_parts,
        cells_per_part=cells_per_part if own else base.cells_per_part,
        constraints=_given(constraints, base.constraints),
    ).run(mesh, registry, progress, verbose, threads)


def _given(argument: _T | None, otherwise: _T) -> _T:
    return otherwise if argument is None else argument
