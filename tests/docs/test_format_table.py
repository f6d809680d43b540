"""The table of formats says what round trips say, and the suite sees what a format loses."""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import format_table
import pytest
from format_table import BEGIN, END, format_names, format_row, round_trips

from agglo_core import FileError, Mesh
from agglo_core.io.npz import Npz
from agglo_core.progress import ignore_progress
from agglo_core.registry import Component, Registry, default, hookimpl

PAGE = Path(__file__).parents[2] / "docs/reference/formats.md"
REMEDY = f"python docs/extensions/format_table.py, in place of the table in {PAGE}"
NAMES = format_names()


def table() -> list[str]:
    text = PAGE.read_text(encoding="utf-8")
    return text[text.index(BEGIN) : text.index(END)].splitlines()


@pytest.mark.parametrize(
    ("name", "suffix"),
    [pytest.param(*own, marks=[pytest.mark.slow] if own[0] == "meshlane" else []) for own in NAMES],
)
def test_the_page_says_what_round_trips_say(name: str, suffix: str) -> None:
    record = default().record("format", name)
    if record.state != "ok":
        pytest.skip(f"{name}: {record.reason}")
    assert format_row(name, suffix) in table(), REMEDY


def test_the_page_has_a_row_for_each_format() -> None:
    rows = [row.split(" | ") for row in table()[4:] if row]
    assert [row[1].strip("`") for row in rows] == [name for name, _ in NAMES], REMEDY
    assert all(suffix in row[0] for row, (_, suffix) in zip(rows, NAMES, strict=True)), REMEDY


class Forgetful(Npz):
    """Holds plane meshes without tags, with few digits."""

    suffixes = (".toy",)

    def write(self, path: Path, mesh: Mesh, *_: Any, **__: Any) -> None:
        if mesh.dim == 3:
            raise FileError("plane meshes only")
        super().write(
            path,
            replace(mesh, points=mesh.points.round(11), cell_tags={}, face_tags={}),
            None,
            ignore_progress,
        )


HOME = ModuleType("format_of_the_page")
HOME.Forgetful = Forgetful  # type: ignore[attr-defined]
sys.modules[HOME.__name__] = HOME


def test_what_a_format_loses_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    class Plugin:
        @hookimpl
        def agglo_components(self) -> list[Component]:
            return [Component("format", "toy", f"{HOME.__name__}:Forgetful")]

    registry = Registry()
    registry.register(Plugin(), "mine", distribution="mine", version="1")
    for name in ("read", "read_hierarchy", "write"):
        monkeypatch.setattr(format_table, name, partial(getattr(format_table, name), registry=registry))
    found = round_trips(".toy")
    assert found is not None
    expected = {"2-D cells": "polygons", "3-D cells": "refused", "digits": "lost", "labels": "lost"}
    expected |= {"cell tags": "lost", "outer faces": "lost", "holes": "yes", "lossless": "no"}
    assert {name: found[name] for name in expected} == expected
