"""The command ``agglo formats``: every declared suffix with its access and contents."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from command_line import Agglo

from agglo_core.registry import Component, default, hookimpl


class Notes:
    """A format of a plugin that only reads, without declared suffixes."""

    suffixes = (".notes",)
    lossless = False

    def read(self, path: Path) -> None:
        """Read nothing."""


@pytest.fixture
def plugin(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A plugin with a format that can be used, one that needs a package, and one without a target."""
    monkeypatch.setitem(__import__("sys").modules, "noting", SimpleNamespace(Notes=Notes))
    components = [
        Component("format", "notes", "noting:Notes", summary="Notes without cells."),
        Component("format", "needy", "noting:Notes", requires=("no_such_module",), suffixes=(".needy",)),
        Component("format", "absent", "noting:Absent"),
    ]
    default().register(SimpleNamespace(agglo_components=hookimpl(lambda: components)), "noting")
    yield
    default().unregister("noting")


def rows(agglo: Agglo) -> dict[str, list[str]]:
    """Return access, format and contents for the suffixes in each row of the table."""
    code, out, err = agglo("formats")
    assert (code, err) == (0, "")
    head, rule, *lines = out.splitlines()
    assert head.split() == ["suffixes", "access", "format", "holds"]
    ends = [place for place in range(1, len(rule)) if rule[place - 1 : place + 1] == " -"]
    table: list[list[str]] = []
    for line in lines:
        cells = [line[a:b].strip() for a, b in zip([0, *ends], [*ends, None], strict=True)]
        if cells[1]:
            table.append(cells)
        else:  # the row above goes on
            table[-1] = [f"{above} {cell}".strip() for above, cell in zip(table[-1], cells, strict=True)]
    return {suffixes: row for suffixes, *row in table}


def test_every_declared_suffix_is_listed_with_its_format(agglo: Agglo) -> None:
    components = [record.component for record in default().list("format") if record.in_tree]
    expected = {" ".join(c.suffixes): (c.name, c.summary) for c in components if c is not None}
    assert {suffixes: (name, holds) for suffixes, (_, name, holds) in rows(agglo).items()} == expected
    assert len(expected) >= 15


def test_formats_that_are_only_read_are_marked(agglo: Agglo) -> None:
    access = {suffixes: row[0] for suffixes, row in rows(agglo).items()}
    assert access[".vtu"] == access[".typ2 .typ1"] == "read, write"
    assert access[".pvtu"] == access[".vtp"] == "read"


def test_formats_of_plugins_are_listed_with_the_reason_why_they_cannot_be_used(
    agglo: Agglo, plugin: None
) -> None:
    table = rows(agglo)
    assert table[".notes"] == ["read", "notes", "Notes without cells."]
    assert table[".needy"][:2] == ["unusable", "needy"]
    assert "no_such_module" in table[".needy"][2]
    assert table["–"][:2] == ["unusable", "absent"]
