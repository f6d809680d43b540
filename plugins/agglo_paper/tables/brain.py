"""Results for a mesh of a brain section, agglo's or the user's, as in the paper's section 4.1."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

from agglo_core.authoring import FileError, MeshError
from agglo_paper.tables.authors import authors_table, authors_units
from agglo_paper.tables.published import band, judge_row, number, published_values
from agglo_paper.tables.record import Page, Row, Table
from agglo_paper.tables.shapes import cell, notes, ratio, units as shape_units
from agglo_paper.work.grids import load
from agglo_paper.work.measures import METRICS
from agglo_paper.work.plan import Plan
from agglo_paper.work.store import Results, Unit

_INTRO = (
    "Agglomerates of {what} to h* = 0.2 D, D the largest distance of two of its points; METIS is asked for "
    "50 parts. The paper's mesh of 14,372 triangles cannot be shipped: our section is another brain "
    "(13,978 triangles of the MNI152 template), so its numbers say how methods compare and can equal the "
    "printed ones only by chance; `--mesh FILE` runs the same on any mesh."
)


def source_of(file: Path) -> str:
    """Return the text by which a mesh file is identified in the results.

    The text contains a digest, so that a changed file is a different source.

    Raises
    ------
    FileError, MeshError
        If the file contains no 2-D mesh.
    """
    try:
        digest = hashlib.sha256(file.read_bytes()).hexdigest()[:16]
    except OSError as error:
        raise FileError(f"{file}: {error.strerror or error}") from None
    source = f"file:{digest}:{file}"
    if load(source).dim != 2:
        raise MeshError(f"{file}: the paper's metrics are for 2-D meshes, given a 3-D one")
    return source


def page_name(source: str) -> str:
    """Return the page name for a mesh."""
    return "brain" if source == "brain" else Path(source.partition(":")[2].partition(":")[2]).stem


def units(plan: Plan, source: str) -> Iterator[Unit]:
    """Yield all computations for a mesh's page."""
    yield from shape_units(plan, [source], ["brain"])
    yield from authors_units(plan, source)


def page(plan: Plan, results: Results, source: str) -> Page:
    """Return the page for a mesh: table as in the paper, all bisectors, and the authors' files."""
    name = page_name(source)
    tables = [
        _as_printed(plan, results, source, name),
        _bisector_table(plan, results, source, name),
        authors_table(plan, results, source, name),
    ]
    what = "our section" if source == "brain" else f"the mesh `{name}`"
    figures = {f"{name}.svg": f"Agglomerates of {name}", f"{name}-boxes.svg": "Box plots of UF and CRc"}
    return Page(name, f"The brain: {name}", _INTRO.format(what=what), tables, figures)


def _as_printed(plan: Plan, results: Results, source: str, name: str) -> Table:
    metis, *learned = plan.compared
    rows = []
    for row, metric in (("UF", "UF"), ("CR", "CRc")):
        numbers, ratios = published_values()["brain"][row], published_values()["brain"][f"{row} relative"]
        direct = {
            strategy.name: cell(
                plan, results, strategy, source, "brain", metric, number(numbers, strategy.name)
            )
            for strategy in plan.compared
        }
        relative = {
            strategy.name: ratio(direct[strategy.name], direct[metis.name], number(ratios, strategy.name))
            for strategy in learned
        }
        rows.append(judge_row("brain", row, direct, band(row.lower())))
        rows.append(judge_row("brain", f"{row} relative", relative, band("ratios")))
    return Table(name, "As printed (CR is CRc)", rows, 4, "metric", notes(plan))


def _bisector_table(plan: Plan, results: Results, source: str, name: str) -> Table:
    rows = []
    for strategy in plan.columns:
        values = {metric: cell(plan, results, strategy, source, "brain", metric) for metric in METRICS}
        K = cell(plan, results, strategy, source, "brain", "K")
        size = cell(plan, results, strategy, source, "brain", "diameter")
        rows.append(Row(strategy.name, {"K": K.text(0), **values, "mean diameter / h*": size}))
    return Table(f"{name}-ours", "Every installed bisector", rows, 3, "bisector")
