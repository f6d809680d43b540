"""A study from its size to its page: plan the work, do what is not stored yet, write."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path

from agglo_core.authoring import AggloError, FileError, staging
from agglo_paper.tables.record import Page
from agglo_paper.work.store import Results, Store, Unit
from shape_study.figure import draw
from shape_study.page import page
from shape_study.plan import Plan, Size, plan_of
from shape_study.ranks import Measured
from shape_study.tables import Group

Begin = Callable[[Sequence[Unit], str], Callable[[Unit, bool], None]]


def build(folder: Path, size: Size, begin: Begin) -> Page:
    """Compute, write ``<what>.md``, ``<what>.json`` and, with matplotlib, a figure of each group.

    Raises
    ------
    FileError
        If the folder cannot be written to.
    AggloError
        If a partition could not be made or measured.
    """
    plan = plan_of(size)
    units = [unit for each in plan.groups for unit in each.units]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        results = Store(folder / "cache").results(units, begin(units, size.what))
        groups = [
            Group(each.key, each.title, _rows(each.units, results), each.kinds, size.degrees)
            for each in plan.groups
        ]
        figures = {} if find_spec("matplotlib") is None else _draw(folder, size, plan, groups)
        made = page(size.what, groups, plan.facts, size.command, figures)
        _write(folder / f"{size.what}.md", made.markdown())
        _write(folder / f"{size.what}.json", json.dumps(made.data(), indent=1, allow_nan=False) + "\n")
    except OSError as error:
        raise FileError(f"{error.filename or folder}: {error.strerror or error}") from error
    return made


def _rows(units: Sequence[Unit], results: Results) -> list[Measured]:
    rows = []
    for unit in units:
        result, asked = results[unit.key], unit.settings
        if "error" in result:
            raise AggloError(f"{asked['recipe']} on {asked['source']}: {result['error']}")
        rows.append(Measured(asked["source"], asked["recipe"], asked["seed"], result))
    return rows


def _draw(folder: Path, size: Size, plan: Plan, groups: Sequence[Group]) -> Mapping[str, str]:
    """Draw the figure of each group; file names with captions."""
    captions = {}
    for group in groups:
        name = "-".join(filter(None, (size.what, group.key))) + ".svg"
        draw(group.rows, plan.shown, folder / name)
        captions[name] = group.titled(plan.caption)
    return captions


def _write(file: Path, text: str) -> None:
    with staging(file) as stage:
        (stage / file.name).write_text(text, encoding="utf-8")
