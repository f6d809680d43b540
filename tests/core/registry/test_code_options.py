"""A TOML file names code only where the user allows it; without that nothing is imported."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import agglo_core as agglo
from agglo_core import Component, FileError, OptionError, Pipeline, Registry, hookimpl, samples
from agglo_core.authoring import ImportPath
from agglo_core.problems import read_problem
from agglo_core.registry.code_options import Written, mark_texts
from agglo_core.registry.construct import resolve
from agglo_core.registry.options import options_of

MESH = samples.squares(4)


class Halves:
    """Cuts at the median of x, or by the function of another module."""

    def __init__(self, rule: ImportPath | None = None, more: tuple[ImportPath, ...] = ()) -> None:
        names = [each for each in (rule, *more) if each is not None]
        assert all(type(name) is str for name in names)
        self.rules = [getattr(importlib.import_module(m), f) for m, _, f in (n.partition(":") for n in names)]

    def bisect(self, graph: agglo.Graph, rng: np.random.Generator) -> Any:
        return np.argsort(np.argsort(graph.centroids[:, 0], kind="stable")) >= graph.n // 2


class Outer:
    """A bisector that builds another one of a table: it knows nothing of files."""

    def __init__(self, inner: Any = None, *, registry: Registry | None = None) -> None:
        options = {key: value for key, value in inner.items() if key != "name"}
        assert registry is not None
        self.bisect = registry.build("bisector", inner["name"], **options).bisect


class Record:
    """A kind of problem whose table chooses a component."""

    kind = "choosing"

    @classmethod
    def from_table(cls, table: dict[str, Any], mesh: agglo.Mesh, folder: Path) -> Record:
        made = cls()
        made.registry.build("bisector", "halves", **table)
        return made

    registry: Registry


class Plugin:
    """What a third party declares."""

    @hookimpl
    def agglo_components(self) -> list[Component]:
        return [
            Component("bisector", "halves", f"{__name__}:Halves"),
            Component("bisector", "outer", f"{__name__}:Outer"),
            Component("problem", "choosing", f"{__name__}:Record"),
        ]


@pytest.fixture
def registry(monkeypatch: pytest.MonkeyPatch) -> Registry:
    monkeypatch.setitem(sys.modules, __name__, sys.modules[Halves.__module__])
    made = agglo.Registry()
    made.register(Plugin(), "mine")
    made.register(importlib.import_module("agglo_core.builtin"), "defaults")
    Record.registry = made
    return made


@pytest.fixture
def trap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with a module ``trap`` whose import leaves a file ``sprung``."""
    (tmp_path / "trap.py").write_text(f"open({str(tmp_path / 'sprung')!r}, 'w').close()\nclass Rule: ...\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path / "sprung"
    sys.modules.pop("trap", None)


TABLES = [
    '{ name = "halves", rule = "trap:Rule" }',
    '{ name = "halves", more = ["trap:Rule"] }',
    '{ name = "outer", inner = { name = "halves", rule = "trap:Rule" } }',
    '{ name = "outer", inner = { name = "outer", inner = { name = "halves", more = ["trap:Rule"] } } }',
]


@pytest.mark.parametrize("table", TABLES)
def test_a_file_imports_nothing_unless_it_is_allowed_to(
    tmp_path: Path, trap: Path, registry: Registry, table: str
) -> None:
    file = tmp_path / "run.toml"
    file.write_text(f"bisector = {table}\nn_parts = 2\nrefiners = []\n")
    match = r"(rule|more) of bisector 'halves' \(plugin 'mine'.*'trap:Rule'.*--allow-code, or allow_code=True"
    with pytest.raises(OptionError, match=match):
        agglo.agglomerate(MESH, config=file, registry=registry)
    with pytest.raises(OptionError, match=match):
        Pipeline.from_toml(file).run(MESH, registry)
    assert not trap.exists()
    assert "trap" not in sys.modules
    assert agglo.agglomerate(MESH, config=file, registry=registry, allow_code=True).parts == [2]
    assert trap.exists()


def test_what_is_typed_or_written_in_python_needs_no_leave(trap: Path, registry: Registry) -> None:
    done = agglo.agglomerate(MESH, bisector=("halves", {"rule": "trap:Rule"}), n_parts=2, registry=registry)
    assert done.parts == [2]
    assert trap.exists()


def test_a_problem_file_is_no_way_around(tmp_path: Path, trap: Path, registry: Registry) -> None:
    file = tmp_path / "p.toml"
    file.write_text('kind = "choosing"\nrule = "trap:Rule"\n')
    with pytest.raises(FileError, match=r"rule of bisector 'halves'.*--allow-code"):
        read_problem(file, MESH, registry)
    assert not trap.exists()
    read_problem(file, MESH, registry, allow_code=True)
    assert trap.exists()


def test_other_texts_of_a_file_are_texts(tmp_path: Path, registry: Registry) -> None:
    """The mark of where a text comes from does not reach a component whose options have types."""
    given = mark_texts({"a": "x", "b": ["y", {"c": "z"}], "d": 1})
    assert given == {"a": "x", "b": ["y", {"c": "z"}], "d": 1}
    assert type(given["b"][1]["c"]) is Written
    file = tmp_path / "run.toml"
    file.write_text('bisector = { name = "inertial" }\nrefiners = [{ name = "interface" }]\nn_parts = 3\n')
    assert agglo.agglomerate(MESH, config=file, registry=registry).parts == [3]


def test_the_type_says_it_in_words(registry: Registry) -> None:
    rule, more = options_of(resolve(registry.record("bisector", "halves"))) or ()
    assert rule.type_name.startswith("code to import and run, as module:attribute (in a file only with")
    assert more.type_name.startswith("tuple of code to import and run")
