"""Computation and output of the result pages named on the command line."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from agglo_core.authoring import FileError, OptionError, staging
from agglo_paper import figures, statistics
from agglo_paper.front_page import command, front
from agglo_paper.tables import brain, multigrid, runtime, shapes
from agglo_paper.tables.record import Page
from agglo_paper.work.grids import GRIDS
from agglo_paper.work.plan import Plan, full, quick
from agglo_paper.work.store import Data, Results, Store, Unit
from agglo_paper.work.strategies import columns

Begin = Callable[[Sequence[Unit], str], Callable[[Unit, bool], None]]
"""Function of a page's units and name that returns a function to call after each unit."""

_TABLES: Final = ("uf", "cr", "brain", *multigrid.TABLES, "statistics", "runtime")
_DRAWN: Final = ("uf", "brain", "runtime")


def build(
    words: Sequence[str],
    folder: Path,
    quickly: bool,
    mesh: Path | None,
    begin: Begin,
    bisectors: Mapping[str, tuple[str, Mapping[str, Any]]] | None = None,
) -> tuple[list[Page], str]:
    """Compute and write the pages and figures for ``words``, and with ``all`` also the front page.

    ``bisectors``, name and options by column heading, replace the installed bisectors.

    Raises
    ------
    FileError
        If the folder cannot be written to, or the mesh cannot be read.
    OptionError
        If figures are requested without matplotlib.
    """
    # 1. Plan
    plan = (quick if quickly else full)(columns(chosen=bisectors))
    sources = ["brain", *([brain.source_of(mesh)] if mesh is not None else [])]
    tables = [word for word in _TABLES if word in words or "all" in words]
    figure_tables = {"uf" if word == "cr" else word for word in tables}  # uf and cr share their figures
    figure_words = [word for word in _DRAWN if word in figure_tables or "figures" in words]
    if "figures" in words and find_spec("matplotlib") is None:
        raise OptionError('figures need matplotlib: pip install "agglo[plot]"')
    # 2. Compute missing results
    try:
        folder.mkdir(parents=True, exist_ok=True)
        results = _compute_results(
            plan, dict.fromkeys([*tables, *figure_words]), sources, Store(folder / "cache"), begin
        )
        # 3. Draw the figures
        if find_spec("matplotlib") is not None:
            _draw(plan, results, figure_words, sources, folder)
        # 4. Write the pages
        pages = [page for word in tables for page in _pages(plan, results, word, sources)]
        pages = [_complete_page(page, plan, results, folder, sources) for page in pages]
        pages = [_append_command(page, quickly, mesh) for page in pages]
        for page in pages:
            _write(folder / f"{page.name}.md", page.markdown())
            _write(folder / f"{page.name}.json", json.dumps(page.data(), indent=1, allow_nan=False) + "\n")
        first = front(plan, results, pages, quickly, mesh) if "all" in words else ""
        if first:
            _write(folder / "README.md", first)
    except OSError as error:
        raise FileError(f"{error.filename or folder}: {error.strerror or error}") from error
    return pages, first


def _complete_page(page: Page, plan: Plan, results: Results, folder: Path, sources: Sequence[str]) -> Page:
    """Add the existing figures and the messages of failed computations to a page."""
    word = next((w for w in _TABLES if w == page.name), "brain")
    failures: dict[str, str] = {}
    for unit in _units(plan, word, sources):
        result = results[unit.key]
        place = f"on {unit.settings.get('source', word)}"
        if "error" in result:
            method = unit.settings.get("strategy", {}).get("name", unit.work.__name__)
            failures.setdefault(f"{method} {place}", result["error"])
        for method, message in result.get("failures", {}).items():
            failures.setdefault(f"{method} {place}", message)
    figures = {name: text for name, text in page.figures.items() if (folder / name).exists()}
    return replace(
        page, figures=figures, failures=[f"{label}: {message}" for label, message in failures.items()]
    )


def _append_command(page: Page, quickly: bool, mesh: Path | None) -> Page:
    """Append to a page's introduction the command line that reproduces the page."""
    word = page.name if page.name in _TABLES else "brain"
    own = mesh if page.name not in _TABLES else None
    return replace(page, intro=f"{page.intro}\n\nMade by `{command(word, quickly, own)}`.")


def _compute_results(
    plan: Plan, words: Iterable[str], sources: Sequence[str], store: Store, begin: Begin
) -> Results:
    results: dict[str, Data] = {}
    for word in words:
        units = {unit.key: unit for unit in _units(plan, word, sources) if unit.key not in results}
        results.update(store.results(units.values(), begin(list(units.values()), word)))
    return results


def _write(file: Path, text: str) -> None:
    with staging(file) as stage:
        (stage / file.name).write_text(text, encoding="utf-8")


def _units(plan: Plan, word: str, sources: Sequence[str]) -> Iterable[Unit]:
    match word:
        case "uf" | "cr":
            return shapes.units(plan)
        case "brain":
            return (unit for source in sources for unit in brain.units(plan, source))
        case "runtime":
            return runtime.units(plan)
        case "statistics":
            return statistics.units(plan)
        case _:
            return multigrid.units(plan)


def _pages(plan: Plan, results: Results, word: str, sources: Sequence[str]) -> list[Page]:
    match word:
        case "uf" | "cr":
            return [shapes.page(plan, results, word)]
        case "brain":
            return [brain.page(plan, results, source) for source in sources]
        case "runtime":
            return [runtime.page(plan, results)]
        case "statistics":
            return [statistics.page(plan, results)]
        case _:
            return [multigrid.page(plan, results, word)]


def _draw(plan: Plan, results: Results, words: Sequence[str], sources: Sequence[str], folder: Path) -> None:
    """Draw the figures for the pages ``words``."""
    if "uf" in words:
        grids = {grid: f"paper:{grid}" for grid in GRIDS}
        figures.draw_grids(plan, list(grids.values()), "run", folder / "grids.svg")
        figures.draw_boxes(plan, results, grids, "run", folder / "boxes.svg")
    for source in sources if "brain" in words else ():
        name = brain.page_name(source)
        figures.draw_grids(plan, [source], "brain", folder / f"{name}.svg")
        figures.draw_boxes(plan, results, {name: source}, "brain", folder / f"{name}-boxes.svg")
    if "runtime" in words:
        figures.draw_runtime(plan, results, folder / "runtime.svg")
