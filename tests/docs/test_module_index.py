"""The index of modules lists every module of the core and the plugins with a headline."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from core.test_layering import MAY_IMPORT
from module_index import PACKAGES, ROOT, folders, headline, modules, table
from sphinx.errors import ExtensionError

MODULES_OF_ALL = {"arrays", "errors", "lazy_names", "suggestions", "threads"}  # one row of the table


def test_every_module_is_listed_once() -> None:
    listed = [file for folder in folders() for file in modules(folder)]
    sources = [*(ROOT / "agglo_core").rglob("*.py"), *(ROOT / "plugins").rglob("*.py")]
    assert len(sources) > 500
    assert sorted(listed) == sorted(sources)


def test_each_module_has_a_headline_of_one_sentence() -> None:
    headlines = {file: headline(file) for folder in folders() for file in modules(folder)}
    assert not [file for file, text in headlines.items() if not text.endswith(".")]


def test_the_table_of_a_folder_has_a_row_for_each_module_but_the_package() -> None:
    folder = ROOT / "agglo_core" / "progress"
    lines = list(table(folder))
    assert lines[1] == headline(folder / "__init__.py")
    rows = [line.split("``")[1] for line in lines if line.startswith("   * - ")]
    assert rows == sorted(file.name for file in folder.glob("*.py") if file.name != "__init__.py")


def test_a_module_without_a_docstring_is_an_error_that_names_it(tmp_path: Path) -> None:
    file = tmp_path / "bare.py"
    file.write_text("x = 1\n")
    with pytest.raises(ExtensionError, match=r"bare\.py: the module has no docstring"):
        headline(file)


def test_the_page_on_architecture_lists_the_rooms_in_the_order_of_imports() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = [line.split("|")[1] for line in page.splitlines() if line.startswith("| `")]
    rooms = [name.strip("/") for row in rows for name in re.findall(r"`(\w+/?)`", row)]
    order = [name for name in rooms if name in MAY_IMPORT]
    assert sorted(order) == sorted(MAY_IMPORT)
    for place, room in enumerate(order):
        assert MAY_IMPORT[room] <= set(order[:place]) | MODULES_OF_ALL, room
    assert {name for name in rooms if name.startswith("agglo_")} == {path.name for path in PACKAGES[1:]}
