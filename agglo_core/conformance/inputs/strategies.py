"""Hypothesis strategies for test inputs: meshes, graphs, and test cases of each kind.

All values are chosen from short lists, the simplest first, so that a failing input shrinks towards a small
plain mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.inputs.cases import labelled_case, seeds_for
from agglo_core.conformance.inputs.drawn import (
    FACES,
    LAYOUTS,
    PLANE,
    SOLID,
    VALUES,
    WEIGHTS,
    DrawnGraph,
    DrawnMesh,
    Layout,
    drawn_labels,
)
from agglo_core.conformance.inputs.mesh_cases import TAG, UNSAFE, report_case
from agglo_core.conformance.inputs.multigrid_cases import COUPLINGS, DrawnLevel
from agglo_core.conformance.inputs.questions import questions
from agglo_core.conformance.inputs.solver_cases import (
    DEFINITE,
    FORMS,
    ORDINARY,
    UNLIKE_DIFFUSION,
    DrawnPlate,
    DrawnProblem,
)
from agglo_core.errors import OptionError
from agglo_core.graph import Graph
from agglo_core.problems import Diffusion, Linear

try:
    from hypothesis import strategies as st
except ImportError as error:
    raise OptionError(f'the laws need hypothesis: pip install "agglo[check]" ({error})') from error

T = TypeVar("T")
Draw = Callable[[Any], Any]

NAMES = (
    "material",
    "region",
    "a name, 50 %",
    "Grösse",
    "cells",
    "points",
    "boundary_of_the_lower_left_part_of_the_domain_1",
    "boundary_of_the_lower_left_part_of_the_domain_2",
)
"""Names of drawn tags; the last two have a long common beginning."""


SIZES = (1, 2, 3, 4, 5, 6, 9, 12, 16, 20, 30, 42, 63, 100, 150)
"""Cell counts of drawn meshes."""


@st.composite
def one_of_values(draw: Draw, values: Sequence[T]) -> T:
    """Draw one of at most 256 values, the simplest first.

    The place is drawn in binary digits: hypothesis draws booleans alike everywhere, but integers also from
    constants of the modules that the caller has imported, so that verdicts would not be reproducible.
    """
    place = 0
    for _ in range(max(len(values) - 1, 0).bit_length()):
        place = 2 * place + draw(st.booleans())
    return values[place % len(values)]


@st.composite
def rarely(draw: Draw, values: Sequence[T]) -> T:
    """Draw the first value in three cases of four, else another."""
    usual = len(values) == 1 or not (draw(st.booleans()) and draw(st.booleans()))
    return values[0] if usual else draw(one_of_values(values[1:]))


@st.composite
def meshes(
    draw: Draw,
    families: Sequence[str] = PLANE,
    sizes: Sequence[int] = SIZES,
    *,
    connected: bool = False,
    shifts: Sequence[float] = (0.0, 3.0, 1e6),
    stretches: Sequence[float] = (1.0, 0.02, 50.0),
) -> DrawnMesh:
    """Draw the recipe of a mesh.

    Parameters
    ----------
    families, sizes : sequence
        Families and cell counts to choose from.
    connected : bool
        Draw only meshes of one component.
    shifts, stretches : sequence of float
        Shifts to choose from, in mesh diameters, and factors of the second coordinate.
    """
    family = draw(one_of_values(families))
    plain = family in ("rectangles", "nonconvex")
    names = draw(rarely(((), NAMES[:1], NAMES[1:4], NAMES[4:][::-1], NAMES)))
    return DrawnMesh(
        family,
        cells=draw(one_of_values(sizes)),
        seed=draw(one_of_values(range(16))),
        jitter=draw(one_of_values((0.0, 0.25))),
        grading=draw(rarely((1.0, 30.0, 1e4))) if plain else 1.0,
        stretch=draw(rarely(stretches)),
        hole=draw(rarely((False, True))),
        copies=1 if connected else draw(rarely((1, 2, 3))),
        turn=draw(rarely((False, True))),
        shift=draw(rarely(shifts)),
        scale=draw(rarely((1.0, 1e-8, 1e8, 1e-3))),
        renumbered=draw(one_of_values((False, True))),
        tags=tuple((name, draw(one_of_values(VALUES))) for name in names),
    )


@st.composite
def graphs(
    draw: Draw, families: Sequence[str] = PLANE, sizes: Sequence[int] = SIZES, *, one_block: bool = False
) -> DrawnGraph:
    """Draw the recipe of a graph, connected with ``one_block``."""
    return DrawnGraph(
        draw(meshes(families, sizes, connected=one_block)),
        blocks=1 if one_block else draw(rarely((1, 2, 5, 40))),
        weights=draw(one_of_values((*WEIGHTS[:1], *WEIGHTS))),
        faces=draw(one_of_values((*FACES, "measures"))),
        barrier=not one_block and draw(rarely((False, True))),
    )


@st.composite
def graph_cases(draw: Draw, subject: Subject, *, one_block: bool = False) -> Case:
    """Draw a test case for a bisector, refiner or fixer, also in 3-D if it promises 3-D."""
    families = (*PLANE, *SOLID) if subject.promised("3d") else PLANE
    if subject.kind == "bisector":
        return graph_case(subject.kind, draw(graphs(families, one_block=one_block)))
    # Many cells and parts, because the rules for moves matter where several parts meet.
    recipe = draw(graphs(families, (2, 1, 4, 9, 16, 30, 63, 100, 150), one_block=one_block))
    layout, parts = draw(one_of_values(LAYOUTS)), draw(one_of_values((2, 3, 1, 5, 9)))
    target = draw(one_of_values(("count", "size", "both")))
    return graph_case(subject.kind, recipe, layout, parts, target)


def graph_case(
    kind: str, recipe: DrawnGraph, layout: Layout = "strips", parts: int = 1, target: str = "count"
) -> Case:
    """Return the test case for a drawn graph, with the code that makes its arguments."""
    graph: Graph = recipe.graph
    name, seed = f"a graph of {graph.n} {recipe.drawn.family}", recipe.drawn.seed
    if graph.n_blocks > 1:
        name += f" in {graph.n_blocks} blocks"
    if kind == "bisector":
        code = f"graph = {recipe!r}.graph"
        return Case(name, (graph, seeds_for(graph.n_blocks, seed)), code)
    labels = drawn_labels(graph, layout, parts, seed)
    code = f"graph = {recipe!r}.graph\nlabels = drawn_labels(graph, {layout!r}, {parts}, {seed})"
    case = labelled_case(kind, graph, name, labels, target, seed)
    # A metric measures the mesh, so that it may be compared where the graph is that of the mesh.
    plain = DrawnGraph(recipe.drawn) == recipe and graph.n_blocks == 1
    return Case(name, case.given, code, recipe.drawn.mesh if plain else None)


@st.composite
def run_cases(draw: Draw, subject: Subject) -> Case:
    """Draw a mesh and a target for an agglomeration run: counts, a number of cells per part, or sizes."""
    families = (*PLANE, *SOLID[:2]) if subject.promised("3d") else PLANE
    recipe = draw(meshes(families, sizes=(4, 6, 9, 16, 30, 63, 100)))
    mesh = recipe.mesh
    most = max(mesh.n_cells // 3, recipe.copies)
    counts = (most, max(most // 3, recipe.copies)) if most // 3 > recipe.copies else (most,)
    target: dict[str, Any] = draw(
        one_of_values(
            ({"n_parts": counts}, {"cells_per_part": 3}, {"h_factor": 2.0}, {"h_factor": (1.5, 4.0)})
        )
    )
    return Case(
        f"{mesh.n_cells} {recipe.family}", (mesh, target), f"mesh = {recipe!r}.mesh\ntarget = {target}"
    )


@st.composite
def metric_cases(draw: Draw, subject: Subject) -> Case:
    """Draw a mesh with labels for a metric, also in 3-D if it promises 3-D."""
    plane = meshes(PLANE, shifts=(0.0, 3.0))
    # Circles and balls in thin parts are found less accurately in 3-D.
    solid = meshes(SOLID, shifts=(0.0, 3.0), stretches=(1.0, 0.2, 5.0))
    recipe = draw(solid if subject.promised("3d") and draw(st.booleans()) else plane)
    layout, parts = draw(one_of_values(LAYOUTS)), draw(one_of_values((1, 2, 3, 5, 9)))
    return metric_case(recipe, layout, parts)


def metric_case(recipe: DrawnMesh, layout: Layout, parts: int) -> Case:
    """Return the test case for a metric or constraint on a drawn mesh."""
    mesh = recipe.mesh
    labels = drawn_labels(mesh.graph, layout, parts, recipe.seed)
    code = f"mesh = {recipe!r}.mesh\nlabels = drawn_labels(mesh.graph, {layout!r}, {parts}, {recipe.seed})"
    return Case(f"{mesh.n_cells} {recipe.family} in {labels.max() + 1} parts", (mesh, labels), code)


@st.composite
def format_cases(draw: Draw, suffix: str) -> Case:
    """Draw a mesh with tags for a file format, which may refuse it."""
    recipe = draw(meshes((*PLANE, *SOLID)))
    mesh = recipe.mesh
    return Case(f"{mesh.n_cells} {recipe.family}", (mesh, suffix), f"mesh = {recipe!r}.mesh")


@st.composite
def levels(draw: Draw, sizes: Sequence[int] = (9, 1, 2, 4, 16, 30, 42, 63)) -> DrawnLevel:
    """Draw the recipe of a multigrid level on a connected mesh."""
    return DrawnLevel(
        DrawnGraph(draw(meshes(sizes=sizes, connected=True, shifts=(0.0,)))),
        layout=draw(one_of_values(LAYOUTS[:3])),
        parts=draw(one_of_values((2, 1, 3, 5, 9))),
        width=draw(one_of_values((1, 1, 2, 3))),
        couplings=draw(one_of_values(COUPLINGS)),
        shift=draw(one_of_values((0.05, 1.0))),
        steps=draw(one_of_values((1, 2, 3, 4))),
        corrected=draw(rarely((False, True))),
        rediscretised=draw(one_of_values((False, True))),
        unit=draw(rarely((1.0, 2.0**20, 2.0**-20))),
    )


@st.composite
def smoother_cases(draw: Draw, subject: Subject) -> Case:
    """Draw a level with right-hand side and approximation for a smoother."""
    recipe: DrawnLevel = draw(levels())
    return recipe.case(subject.kind)


@st.composite
def coarsening_cases(draw: Draw, subject: Subject) -> Case:
    """Draw a test case for a transfer, coarse operator or coarse solver, with nearly singular matrices."""
    sizes = (9, 1, 2, 4, 16, 42, 63) if subject.kind != "coarse_solver" else (9, 1, 2, 16, 63, 200, 400)
    recipe: DrawnLevel = replace(draw(levels(sizes)), shift=draw(one_of_values((0.05, 1.0, 1e-6))))
    return recipe.case(subject.kind)


@st.composite
def constraint_cases(draw: Draw, subject: Subject) -> Case:
    """Draw a mesh with the tag ``region`` on cells and faces, and labels, for a constraint."""
    families = (*PLANE, *SOLID[:2]) if subject.promised("3d") else PLANE
    recipe = draw(meshes(families, sizes=(9, 1, 2, 4, 16, 30, 63), shifts=(0.0, 3.0)))
    recipe = replace(recipe, tags=((TAG, draw(one_of_values(VALUES))),))
    return metric_case(recipe, draw(one_of_values(LAYOUTS)), draw(one_of_values((2, 1, 3, 5, 9))))


@st.composite
def mesh_cases(draw: Draw, subject: Subject) -> Case:
    """Draw a mesh for a kind of problem, or a mesh and a problem for a discretisation."""
    families = (*PLANE, *SOLID[:3]) if subject.promised("3d") else PLANE
    recipe = draw(meshes(families, (9, 1, 2, 4, 16, 30), shifts=(0.0, 3.0), stretches=(1.0, 0.2, 5.0)))
    mesh, code = recipe.mesh, f"mesh = {recipe!r}.mesh"
    if subject.kind == "problem":
        return Case(mesh.name, (mesh,), code)
    kind = next((kind for kind in subject.build().accepts if kind != "diffusion"), "diffusion")
    return Case(mesh.name, (subject.problem(kind).example(mesh), mesh), code)


@st.composite
def section_cases(draw: Draw, subject: Subject) -> Case:
    """Draw a mesh and runs for a section of the report, with names that need escapes."""
    recipe = draw(meshes((*PLANE, *SOLID[:2]), (9, 1, 4, 30)))
    name = draw(one_of_values((UNSAFE, "<script>alert(1)</script>", "a<b & c", '" onload="alert(1)')))
    case = report_case(replace(recipe.mesh, name=name), name)
    return replace(case, code=f"mesh = {recipe!r}.mesh\nname = {name!r}")


def solver_cases(
    subject: Subject,
    sorts: Sequence[str] = ORDINARY,
    options: Sequence[Mapping[str, Any]] = ({},),
    tags: tuple[tuple[str, str], ...] = (),
) -> Any:
    """Draw problems of the given sorts, except for kinds of problem that a solver refuses.

    For a solver of other kinds of problem, draw from their examples. Return None if nothing is left.
    """
    standard = questions(subject)
    accepted = {case.sort for case in standard}
    widths = (1, 1) * ("linear" in accepted) + (2, 3) * ("linear, in blocks" in accepted)
    drawn = [
        sort
        for sort in sorts
        if ("Diffusion" in accepted if sort in ("diffusion", "undefined source") else widths)
    ]
    others = [case for case in standard if not isinstance(case.given[0], Diffusion | Linear)]
    choices: list[str | Case] = [*drawn, *([] if tags else others)]
    return _solver_cases(subject, choices, widths or (1,), options, tags) if choices else None


@st.composite
def _solver_cases(
    draw: Draw,
    subject: Subject,
    choices: Sequence[str | Case],
    widths: Sequence[int],
    options: Sequence[Mapping[str, Any]],
    tags: tuple[tuple[str, str], ...],
) -> Case:
    choice = draw(one_of_values(choices))
    if isinstance(choice, Case):
        return replace(choice, options=draw(one_of_values(options)))
    families = (*PLANE, *SOLID[:2]) if subject.promised("3d") else PLANE
    drawn = meshes(
        families, (9, 1, 2, 4, 16, 30), connected=bool(tags), shifts=(0.0, 3.0), stretches=(1.0, 0.2, 5.0)
    )
    recipe = DrawnProblem(
        replace(draw(drawn), tags=tags),
        choice,
        layout=draw(one_of_values(LAYOUTS[:4])),
        parts=draw(one_of_values((4, 1, 2, 9))),
        levels=draw(one_of_values((1, 2, 3))),
        width=draw(one_of_values(widths)),
        form=draw(one_of_values(FORMS)),
        meshless=draw(rarely((False, True))),
    )
    return replace(recipe.case, options=draw(one_of_values(options)))


def linear_cases(subject: Subject) -> Any:
    """Draw linear systems, also unlike diffusion, which a solver may refuse."""
    return solver_cases(subject, (*ORDINARY[1:], *DEFINITE, *UNLIKE_DIFFUSION))


@st.composite
def plates(draw: Draw, subject: Subject) -> DrawnPlate:
    """Draw a diffusion problem with a known solution, also in 3-D if the solver promises 3-D."""
    solid = subject.promised("3d") and draw(st.booleans())
    recipe = DrawnMesh(
        "boxes" if solid else "rectangles",
        cells=draw(one_of_values((16, 1, 4, 30))),
        grading=draw(rarely((1.0, 5.0))),
        stretch=draw(one_of_values((1.0, 0.5, 3.0))),
        shift=draw(rarely((0.0, 3.0, 1e6))),
        scale=draw(rarely((1.0, 1e-3, 1e3))),
        renumbered=draw(one_of_values((False, True))),
    )
    return DrawnPlate(
        recipe,
        left=draw(one_of_values((1.0, 4.0))),
        right=draw(one_of_values((1.0, 50.0, 0.1))),
        form=draw(one_of_values(FORMS)),
        fluxes=draw(one_of_values((0, 1, 2, 3))),
        merged=draw(st.booleans()),
        tag=draw(one_of_values(("boundary", "edge"))),
    )
