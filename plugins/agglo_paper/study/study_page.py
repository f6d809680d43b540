"""The page of the study: which metric tells what about a partition, and what bad shapes cost."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from agglo_paper.record import Cell, Page, Row, Table
from agglo_paper.store import versions
from agglo_paper.study.ranks import Measured, correlations, costs, relative
from agglo_paper.study.study_work import ERRORS, SOLVERS, TOLERANCE

__all__ = ["page"]

_COEFFICIENTS: Final = ("κ = 1", "κ jumps")
_INTRO: Final = """\
What the shapes of agglomerates do to solutions. Partitions of {meshes} in {parts} parts each, \
{partitions} of every mesh, from excellent to bad: by the usual methods, and by random points, \
growth, stretching and shaking. Of each: iterations to {tolerance:g} of two levels, with fractions, \
by the default solver `polydg_mg`, by its recipe `patches` and by the paper's `polydg_mg_paper` \
(with inherited operators; 500 at most), for κ = 1 and for κ that jumps by 1,000 between the squares \
of a 5 × 5 chessboard; and the errors in L2 and in the DG norm of PolyDG on the mesh of the parts \
against sin πx sin πy. Degrees: p = {degrees}.

A correlation is Spearman's, of ranks, mesh by mesh, and stands for the mean over the meshes. 1: \
whenever one of two partitions is worse by the metric, so is what it leads to; 0: the metric tells \
nothing. Metrics are means over the parts; `compactness` (the energy of k-means), `interface`, \
`shape` (what the polish pursues), `balance`, `diameter` (the largest), `cut` and `normalised_cut` \
are numbers of the whole partition. – : all partitions lead to the same, as with the default solver \
where its recipe does without agglomerates.

Made by `{command}` with {versions}."""


def page(rows: Sequence[Measured], parts: int, degrees: Sequence[int], command: str) -> Page:
    """The page ``shapes``, made by a command line."""
    sources = list(dict.fromkeys(row.source for row in rows))
    per_mesh = len(rows) // len(sources)
    intro = _INTRO.format(
        meshes=", ".join(f"`{each}`" for each in sources),
        parts=parts,
        partitions=per_mesh,
        tolerance=TOLERANCE,
        degrees=", ".join(map(str, degrees)),
        command=command,
        versions=", ".join(f"{name} {version}" for name, version in versions().items()),
    )
    usual = [row for row in rows if row.usual]
    tables = [
        _summary("all", f"All {per_mesh} partitions of a mesh, degrees together", rows, degrees),
        _summary("usual", f"The usual methods alone, {len(usual) // len(sources)} of a mesh", usual, degrees),
        *(_of_degree(rows, degree) for degree in degrees),
        _costs(rows, degrees),
        _recipes(rows, degrees),
    ]
    caption = "Errors and iterations against UF, CR, J and the energy of k-means"
    return Page("shapes", "What shapes are for", intro, tables, {"shapes.svg": caption})


def _kinds() -> list[str]:
    """What is measured, without the degree."""
    return [*(f"{name} {what}" for name in SOLVERS for what in _COEFFICIENTS), *ERRORS]


def _metrics(rows: Sequence[Measured]) -> list[str]:
    return [] if not rows else list(rows[0].result["metrics"])


def _summary(name: str, title: str, rows: Sequence[Measured], degrees: Sequence[int]) -> Table:
    """Correlations, the mean over the degrees; the best metrics come first."""
    names = _metrics(rows)
    columns: dict[str, dict[str, float]] = {metric: {} for metric in names}
    for kind in _kinds():
        found = correlations(rows, names, [f"{kind} p{degree}" for degree in degrees])
        for metric, values in found.items():
            known = [each for each in values if np.isfinite(each)]
            columns[metric][kind] = float(np.mean(known)) if known else float("nan")
    note = "mean of the rank correlations over degrees and meshes; the metrics in the order of their means"
    return Table(name, title, _ranked(columns), 2, "metric", [note])


def _of_degree(rows: Sequence[Measured], degree: int) -> Table:
    kinds, names = _kinds(), _metrics(rows)
    found = correlations(rows, names, [f"{kind} p{degree}" for kind in kinds])
    columns = {metric: dict(zip(kinds, values, strict=True)) for metric, values in found.items()}
    return Table(f"p{degree}", f"All partitions, p = {degree}", _ranked(columns), 2, "metric")


def _ranked(columns: dict[str, dict[str, float]]) -> list[Row]:
    """A row for each metric that is defined somewhere, those that tell most first."""

    def mean(metric: str) -> float:
        known = [each for each in columns[metric].values() if np.isfinite(each)]
        return float(np.mean(known)) if known else -np.inf

    names = sorted((name for name in columns if np.isfinite(mean(name))), key=mean, reverse=True)
    return [Row(name, {kind: Cell(each) for kind, each in columns[name].items()}) for name in names]


def _costs(rows: Sequence[Measured], degrees: Sequence[int]) -> Table:
    outcomes = [f"{kind} p{degree}" for degree in degrees for kind in _kinds()]
    found = [
        (
            f"{who}, p = {degree}",
            {kind: Cell(values[outcomes.index(f"{kind} p{degree}")]) for kind in _kinds()},
        )
        for who, values in costs(rows, outcomes).items()
        for degree in degrees
    ]
    return Table("costs", "What bad shapes cost", [Row(*each) for each in found], 2, "partitions")


def _recipes(rows: Sequence[Measured], degrees: Sequence[int]) -> Table:
    """How each recipe does, over the best partition of each mesh, degrees together."""
    kinds = _kinds()
    found = relative(rows, [f"{kind} p{degree}" for kind in kinds for degree in degrees])
    table = {
        recipe: np.exp(np.log(values).reshape(len(kinds), len(degrees)).mean(axis=1)).tolist()
        for recipe, values in found.items()
    }
    ordered = sorted(table, key=lambda recipe: float(np.log(table[recipe]).mean()))
    lines = [
        Row(recipe, {kind: Cell(each) for kind, each in zip(kinds, table[recipe], strict=True)})
        for recipe in ordered
    ]
    note = "over the best partition of each mesh: geometric means over meshes, seeds and degrees"
    return Table("recipes", "How the partitions do", lines, 2, "partition", [note])
