"""Build a run's components from the user's choices: names, names with options, or objects."""

from __future__ import annotations

from collections.abc import Sequence

from agglo_core.agglomeration.keywords import POLISH, SIZES, Choice, Keywords
from agglo_core.agglomeration.run import Run
from agglo_core.errors import AggloError, OptionError, PluginError
from agglo_core.graph import Graph
from agglo_core.mesh.elsewhere import import_function
from agglo_core.progress import Listener
from agglo_core.registry import KINDS, Registry, describe
from agglo_core.registry.attribution import Member
from agglo_core.registry.options import is_named, name_and_options


def new_run(keywords: Keywords, registry: Registry, progress: Listener | None = None) -> Run:
    """Create a run with the components of the given keywords.

    In a k-way run the bisector must have ``partition``. Parts that still need splitting after a direct
    partition are bisected by this bisector, or by ``inertial`` if the bisector has no bisection method.
    """
    kway = keywords.method == "kway"
    # 1. Check that the bisector supports the method.
    member, fallback = build_component("bisector", keywords.bisector, registry)
    bisects = member.offers("bisect_level", "bisect")
    if kway and not member.offers("partition"):
        raise OptionError(f"{member.title} has no k-way partition; use method='recursive'")
    if not kway and not bisects:
        raise OptionError(f"{member.title} cannot bisect; use method='kway'")
    # 2. Build all components. A partitioner without bisection methods gets ``inertial`` as bisector.
    stand_in = None if fallback is None else _stand_in(member, "declares the fallback", fallback, registry)
    return Run(
        bisector=member if bisects else _stand_in(member, "cannot bisect and needs", "inertial", registry),
        refiners=[build_component("refiner", each, registry)[0] for each in keywords.refiners],
        post_refiners=_polishers(keywords.post_refiners if keywords.polish else (), registry),
        fixer=build_component("fixer", keywords.fixer, registry)[0],
        fallback=stand_in,
        partitioner=member if kway else None,
        listen=registry.level_done,
        seed=keywords.seed,
        progress=progress,
    )


def require_points(graph: Graph, keywords: Keywords, run: Run) -> None:
    """Raise OptionError if the run needs points and all points of the graph coincide.

    Sizes need points, and so do bisectors with ``needs_points = True``.
    """
    first, last = graph.centroids[:1], graph.centroids[-1:]  # they usually differ, unlike those of a pillar
    if graph.n < 2 or (last != first).any() or (graph.centroids != first).any():
        return
    problem = "all points of the graph coincide, as in Graph.from_scipy(A) without points; give points, or"
    sizes = [name for name in SIZES if getattr(keywords, name) is not None]
    if sizes:
        raise OptionError(f"{sizes[0]} needs points, but {problem} n_parts or cells_per_part")
    chosen = run.partitioner or run.bisector
    if getattr(chosen.tool, "needs_points", False):
        remedy = "choose a bisector that uses edges only, such as 'metis' or 'spectral'"
        raise OptionError(f"{chosen.title} splits by coordinates, but {problem} {remedy}")


def _polishers(choices: Sequence[Choice], registry: Registry) -> list[Member]:
    if choices is POLISH and not registry.declares("refiner", POLISH[0]):
        ours = import_function("agglo_core.refine.compactness.refiner:CompactnessRefiner")()
        return [Member(ours, f"refiner {POLISH[0]!r}")]
    return [build_component("refiner", each, registry)[0] for each in choices]


def _stand_in(bisector: Member, reason: str, choice: Choice, registry: Registry) -> Member:
    try:
        return build_component("bisector", choice, registry)[0]
    except AggloError as error:
        raise PluginError(f"{bisector.title} {reason} {choice!r}: {error}") from error


def build_component(kind: str, choice: Choice, registry: Registry) -> tuple[Member, Choice | None]:
    """Build the chosen component, and return it with its declared fallback component."""
    if is_named(choice):
        name, options = name_and_options(kind, choice)
        record = registry.record(kind, name)
        tool = registry.assemble(record, options)
        return Member(tool, describe(record)), record.component.fallback if record.component else None
    methods = KINDS[kind].methods
    if isinstance(choice, type) or not any(callable(getattr(choice, each, None)) for each in methods):
        raise OptionError(
            f"{choice!r} is not a {kind}: expected a name or an object with {' or '.join(methods)}"
        )
    return Member(choice, f"{kind} {type(choice).__name__}"), getattr(choice, "fallback", None)


def short_name(choice: Choice) -> str:
    """Return the name of a chosen component for the statistics."""
    if isinstance(choice, str):
        return choice
    return str(choice[0]) if is_named(choice) else type(choice).__name__
