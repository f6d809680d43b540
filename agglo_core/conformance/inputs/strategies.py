"""Hypothesis strategies for test inputs: meshes, graphs, and test cases of each kind.

All values are chosen from short lists, the simplest first, so that a failing input shrinks towards a small
plain mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from agglo_core.conformance.base import Case, Subject
from agglo_core.conformance.inputs.cases import graph_case, mesh_case
from agglo_core.conformance.inputs.drawn import (
    FACES,
    LAYOUTS,
    PLANE,
    SOLID,
    VALUES,
    WEIGHTS,
    DrawnGraph,
    DrawnMesh,
)
from agglo_core.conformance.inputs.mesh_cases import TAG, UNSAFE, report_case
from agglo_core.conformance.inputs.multigrid_cases import COUPLINGS, DrawnLevel
from agglo_core.errors import OptionError

try:
    from hypothesis import strategies as st
except ImportError as error:
    raise OptionError(f'the laws need hypothesis: pip install "agglo[check]" ({error})') from error

T = TypeVar("T")
Draw = Callable[[Any], Any]
composite = st.composite

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


@composite
def one_of_values(draw: Draw, values: Sequence[T]) -> T:
    """Draw one of at most 256 values, the simplest first.

    The place is drawn in binary digits: hypothesis draws booleans alike everywhere, but integers also from
    constants of the modules that the caller has imported, so that verdicts would not be reproducible.
    """
    place = 0
    for _ in range(max(len(values) - 1, 0).bit_length()):
        place = 2 * place + draw(st.booleans())
    return values[place % len(values)]


@composite
def rarely(draw: Draw, values: Sequence[T]) -> T:
    """Draw the first value in three cases of four, else another."""
    usual = len(values) == 1 or not (draw(st.booleans()) and draw(st.booleans()))
    return values[0] if usual else draw(one_of_values(values[1:]))


@composite
def meshes(
    draw: Draw,
    families: Sequence[str] = PLANE,
    sizes: Sequence[int] = SIZES,
    *,
    connected: bool = False,
    shifts: Sequence[float] = (0.0, 3.0, 1e6),
    stretches: Sequence[float] = (1.0, 0.02, 50.0),
    tagged: bool = False,
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
    tagged : bool
        Draw only meshes with tags.
    """
    family = draw(one_of_values(families))
    plain = family in ("rectangles", "nonconvex")
    names = draw(rarely(((), NAMES[:1], NAMES[1:4], NAMES[4:][::-1], NAMES)[tagged:]))
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


@composite
def graphs(
    draw: Draw,
    families: Sequence[str] = PLANE,
    sizes: Sequence[int] = SIZES,
    blocks: Sequence[int] = (1, 2, 5, 40),
    tagged: bool = False,
) -> DrawnGraph:
    """Draw the recipe of a graph, which is connected if only one block is allowed."""
    connected = max(blocks) == 1
    return DrawnGraph(
        draw(meshes(families, sizes, connected=connected, tagged=tagged)),
        blocks=draw(rarely(blocks)),
        weights=draw(one_of_values((*WEIGHTS[:1], *WEIGHTS))),
        faces=draw(one_of_values((*FACES, *FACES[:2], "measures"))),
        barrier=not connected and draw(rarely((False, True))),
        gathered=draw(rarely((False, False, True))),
    )


@composite
def graph_cases(
    draw: Draw,
    subject: Subject,
    families: Sequence[str] | None = None,
    blocks: Sequence[int] = (1, 2, 5, 40),
    tagged: bool = False,
) -> Case:
    """Draw a test case for a bisector, refiner or fixer, also in 3-D if it promises 3-D."""
    families = families or ((*PLANE, *SOLID) if subject.promised("3d") else PLANE)
    if subject.kind == "bisector":
        return graph_case(subject.kind, draw(graphs(families, SIZES, blocks, tagged)))
    # Many cells and parts, because the rules for moves matter where several parts meet.
    recipe = draw(graphs(families, (2, 1, 4, 9, 16, 30, 63, 100, 150), blocks, tagged))
    layout, parts = draw(one_of_values(LAYOUTS)), draw(one_of_values((2, 3, 1, 5, 9)))
    target = draw(one_of_values(("count", "size", "both")))
    return graph_case(subject.kind, recipe, layout, parts, target)


@composite
def irregular_cases(draw: Draw, subject: Subject) -> Case:
    """Draw a test case on a mesh without symmetries, also in 3-D if the component promises 3-D."""
    # A fixer breaks ties between pieces of equal size, which scattered labels of equal cells have.
    fixer = subject.kind == "fixer"
    solid = subject.promised("3d") and draw(st.booleans())
    families = ("voronoi3d", "tetrahedra") if solid else ("rectangles", "voronoi", "triangles")
    recipe = DrawnMesh(
        draw(one_of_values(families)),
        cells=draw(one_of_values((30, 63, 20, 100))),
        seed=draw(one_of_values(range(16))),
        jitter=0.0 if fixer else 0.25,
        stretch=draw(one_of_values((1.7, 0.4))),
    )
    layout = draw(one_of_values(("scattered",) if fixer else LAYOUTS[:4]))
    return graph_case(subject.kind, DrawnGraph(recipe), layout, draw(one_of_values((3, 2, 5))))


@composite
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


@composite
def metric_cases(
    draw: Draw,
    subject: Subject,
    families: Sequence[str] | None = None,
    options: Sequence[Mapping[str, Any]] = ({},),
) -> Case:
    """Draw a mesh with labels for a metric, also in 3-D if it promises 3-D, and options of the metric."""
    solid = families == SOLID or (subject.promised("3d") and draw(st.booleans()))
    # Circles and balls in thin parts are found less accurately in 3-D.
    stretches = (1.0, 0.2, 5.0) if solid else (1.0, 0.02, 50.0)
    recipe = draw(meshes(families or (SOLID if solid else PLANE), shifts=(0.0, 3.0), stretches=stretches))
    case = mesh_case(recipe, draw(one_of_values(LAYOUTS)), draw(one_of_values((1, 2, 3, 5, 9))))
    return replace(case, options=draw(one_of_values(options)))


@composite
def format_cases(draw: Draw, suffix: str) -> Case:
    """Draw a mesh with tags for a file format, which may refuse it."""
    # Formats refuse tags that they do not hold: those without tags of faces are judged by tags of cells.
    recipe = replace(draw(meshes((*PLANE, *SOLID))), tagged=draw(one_of_values(("cells", "both", "faces"))))
    mesh = recipe.mesh
    return Case(f"{mesh.n_cells} {recipe.family}", (mesh, suffix), f"mesh = {recipe!r}.mesh")


@composite
def levels(
    draw: Draw, sizes: Sequence[int] = (9, 1, 2, 4, 16, 30, 42, 63), mixings: Sequence[float] = (0.05,)
) -> DrawnLevel:
    """Draw the recipe of a multigrid level on a connected mesh."""
    return DrawnLevel(
        DrawnGraph(draw(meshes(sizes=sizes, connected=True, shifts=(0.0,)))),
        layout=draw(one_of_values(LAYOUTS[:3])),
        parts=draw(one_of_values((2, 1, 3, 5, 9))),
        width=draw(one_of_values((1, 1, 2, 3))),
        mixing=draw(one_of_values(mixings)),
        couplings=draw(one_of_values(COUPLINGS)),
        shift=draw(one_of_values((0.05, 1.0))),
        steps=draw(one_of_values((1, 2, 3, 4))),
        corrected=draw(rarely((False, True))),
        rediscretised=draw(one_of_values((False, True))),
        unit=draw(rarely((1.0, 2.0**20, 2.0**-20))),
    )


@composite
def smoother_cases(draw: Draw, subject: Subject, mixings: Sequence[float] = (0.05,)) -> Case:
    """Draw a level with right-hand side and approximation for a smoother.

    ``mixings`` are the couplings of the unknowns of a cell to choose from.
    """
    recipe: DrawnLevel = draw(levels(mixings=mixings))
    return recipe.case(subject.kind)


@composite
def coarsening_cases(draw: Draw, subject: Subject) -> Case:
    """Draw a test case for a transfer, coarse operator or coarse solver, with nearly singular matrices."""
    special = {"transfer": (16, 1, 4, 9, 30, 63), "coarse_solver": (9, 1, 2, 16, 63, 200, 400)}
    sizes = special.get(subject.kind, (9, 1, 2, 4, 16, 42, 63))
    recipe: DrawnLevel = replace(draw(levels(sizes)), shift=draw(one_of_values((0.05, 1.0, 1e-6))))
    if subject.kind == "transfer":
        flags = (False, True)
        width, uneven = draw(one_of_values((2, 1, 3))), draw(rarely(flags))
        recipe = replace(recipe, width=width, uneven=uneven, rotated=not uneven)
        recipe = replace(recipe, couplings="even") if uneven else recipe
    return recipe.case(subject.kind)


@composite
def constraint_cases(draw: Draw, subject: Subject, families: Sequence[str] | None = None) -> Case:
    """Draw a mesh with the tag ``region`` on cells and faces, and labels, for a constraint."""
    families = families or ((*PLANE, *SOLID[:2]) if subject.promised("3d") else PLANE)
    recipe = draw(meshes(families, sizes=(9, 1, 2, 4, 16, 30, 63), shifts=(0.0, 3.0)))
    recipe = replace(recipe, tags=((TAG, draw(one_of_values(VALUES))),))
    return mesh_case(recipe, draw(one_of_values(LAYOUTS)), draw(one_of_values((2, 1, 3, 5, 9))))


@composite
def mesh_cases(draw: Draw, subject: Subject) -> Case:
    """Draw a mesh for a kind of problem, or a mesh and a problem for a discretisation."""
    families = (*PLANE, *SOLID[:3]) if subject.promised("3d") else PLANE
    recipe = draw(meshes(families, (9, 1, 2, 4, 16, 30), shifts=(0.0, 3.0), stretches=(1.0, 0.2, 5.0)))
    mesh, code = recipe.mesh, f"mesh = {recipe!r}.mesh"
    if subject.kind == "problem":
        return Case(mesh.name, (mesh,), code)
    kind = next((kind for kind in subject.build().accepts if kind != "diffusion"), "diffusion")
    return Case(mesh.name, (subject.problem(kind).example(mesh), mesh), code)


@composite
def section_cases(draw: Draw, subject: Subject) -> Case:
    """Draw a mesh and runs for a section of the report, with names that need escapes."""
    recipe = draw(meshes((*PLANE, *SOLID[:2]), (9, 1, 4, 30)))
    name = draw(one_of_values((UNSAFE, "<script>alert(1)</script>", "a<b & c", '" onload="alert(1)')))
    recipe, completed = replace(recipe, tags=((name, "small"),)), draw(rarely((True, False)))
    case = report_case(replace(recipe.mesh, name=name), name, completed=completed)
    return replace(case, code=f"mesh = {recipe!r}.mesh\nname = {name!r}")
