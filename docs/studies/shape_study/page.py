"""The pages of the studies: what was done, in words, and the tables of each group."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from agglo_paper.tables.record import Page
from agglo_paper.work.store import versions
from shape_study.tables import Group, tables
from shape_study.work import TOLERANCE

TITLES: Final = {
    "shapes": "What shapes are for",
    "levels": "What shapes are for: four levels",
    "solids": "What shapes are for: in space",
}
_SHAPES: Final = """\
What the shapes of agglomerates do to solutions. Partitions of {meshes} in {parts} parts each, \
{partitions} of every mesh, from excellent to bad: by the usual methods, and by random points, \
growth, stretching and shaking. Of each: iterations to {tolerance:g} of two levels, with fractions, \
by the default solver `polydg_mg`, by its recipe `patches` and by the paper's `polydg_mg_paper` \
(with inherited operators; 500 at most), for κ = 1 and for κ that jumps by 1,000 between the squares \
of a 5 × 5 chessboard; and the errors in L2 and in the DG norm of PolyDG on the mesh of the parts \
against sin πx sin πy. Degrees: p = {degrees}. Other pages: [four levels](levels.md), [three \
dimensions](solids.md)."""
_LEVELS: Final = """\
As [two levels](shapes.md), but with the mesh and three levels of agglomerates, the parts of \
{per_part} cells on average. Nested partitions of {meshes}, {partitions} of every mesh and kind, \
from excellent to bad. At equal numbers of parts, {parts}; and at equal sizes h*, the diagonals of \
squares of as many mean cells: there the number of parts is free, and no part but a single cell is \
wider. Iterations to {tolerance:g}, with fractions, by the default solver `polydg_mg`, by its recipe \
`patches` and by the paper's `polydg_mg_paper` (with inherited operators; 500 at most), for κ = 1 \
and for κ that jumps by 1,000 between the squares of a 5 × 5 chessboard. Degrees: p = {degrees}."""
_SOLIDS: Final = """\
As [in the plane](shapes.md), but in space, **without PolyDG**, which was for the plane alone \
when this ran. Finite volumes take its place, −∇·(κ∇u) = 1 with u = 0 on the boundary, one \
unknown in each cell and two-point fluxes; so nothing here is about polynomials of degree 1 or \
more, and iterations are those of algebraic multigrid on a matrix of that kind. Partitions of \
{meshes}, {partitions} of every mesh and kind, from excellent to bad: one level of parts of \
{two} cells on average (two levels with the mesh), or three of {four} (four levels with the \
mesh). At equal numbers of parts; and at equal sizes h*, the diagonals of cubes of as many mean \
cells, where the number of parts is free. Iterations to {tolerance:g}, with fractions (500 at \
most), for κ = 1 and for κ that jumps by 1,000 between the cubes of a 5 × 5 × 5 chessboard, by: \
*default*, `polydg_mg:recipe=agglomerates`, which makes a classical level before those of the \
agglomerates (left alone it does without agglomerates); *smoothed*, `multigrid`, smoothed \
aggregation; *constants*, `multigrid:transfer=injection`, functions constant on the parts; \
*paper*, `polydg_mg_paper` with its smoother. *approximation* is the least error in L2 of linear \
functions on the parts of the finest level against sin πx sin πy sin πz, in the middle of the \
cells."""
_RANKS: Final = """\
A correlation is Spearman's, of ranks, mesh by mesh, and stands for the mean over the meshes. 1: \
whenever one of two partitions is worse by the metric, so is what it leads to; 0: the metric tells \
nothing. Metrics are means over the parts; `compactness` (the energy of k-means), `interface`, \
`shape` (what the polish pursues), `roundness`, `balance`, `diameter` (the largest), `cut` and \
`normalised_cut` are numbers of the whole partition. – : all partitions lead to the same, as with \
the default solver where its recipe does without agglomerates."""
_SEVERAL: Final = """\
Metrics are means over the levels, too, and numbers of the whole partition geometric means. At equal \
sizes `parts` is the number of parts on all levels together: as an outcome, what a size costs; as a \
metric, of which fewer are better. More parts are a finer space, so with a size given bad \
partitions, which need many parts, take few iterations. Tables in which the number of parts is taken \
out have partial correlations: what a metric tells of partitions in as many parts."""
_INTROS: Final = {
    "shapes": (_SHAPES, _RANKS),
    "levels": (_LEVELS, _RANKS, _SEVERAL),
    "solids": (_SOLIDS, _RANKS, _SEVERAL),
}


def page(
    what: str, groups: Sequence[Group], facts: Mapping[str, Any], command: str, figures: Mapping[str, str]
) -> Page:
    """The page of a study; ``facts`` are what its words mention besides the partitions."""
    first = groups[0]
    intro = "\n\n".join((*_INTROS[what], "Made by `{command}` with {versions}.")).format(
        meshes=", ".join(f"`{each}`" for each in first.sources),
        partitions=len(first.rows) // len(first.sources),
        tolerance=TOLERANCE,
        command=command,
        versions=", ".join(f"{name} {version}" for name, version in versions().items()),
        **facts,
    )
    return Page(what, TITLES[what], intro, [each for group in groups for each in tables(group)], figures)
