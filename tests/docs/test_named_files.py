"""Files and functions that the pages on the inside of agglo name are where the pages say."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [DOCS / "architecture.md", DOCS / "mathematics.md", *sorted((DOCS / "why").glob("*.md"))]
SOURCES = [file for part in ("agglo_core", "plugins", "tests") for file in (ROOT / part).rglob("*.py")]
FILE = re.compile(r"`([\w/]+\.py)`")
PLACE = re.compile(r"`(?:\w+\.)*(\w+)`\s(?:\(|in\s)`([\w/]+\.py)`")


def files_named(path: str) -> list[Path]:
    """List the sources that a path, whole or without its first folders, may mean."""
    return [file for file in SOURCES if f"/{file.relative_to(ROOT).as_posix()}".endswith(f"/{path}")]


@cache
def defined(file: Path) -> set[str]:
    """Return the names of the functions and classes of a file, nested ones too, and of its constants."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    inside = {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    targets = [target for node in tree.body if isinstance(node, ast.Assign) for target in node.targets]
    return inside | {target.id for target in targets if isinstance(target, ast.Name)}


def test_every_path_on_a_page_means_one_source() -> None:
    named = {(page.name, path) for page in PAGES for path in FILE.findall(page.read_text(encoding="utf-8"))}
    assert len(named) > 80
    assert not [pair for pair in sorted(named) if len(files_named(pair[1])) != 1]


def test_every_function_is_in_the_file_that_a_page_names_for_it() -> None:
    text = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
    places = set(PLACE.findall(text))
    assert len(places) > 50
    assert not [
        (name, path) for name, path in places if not any(name in defined(file) for file in files_named(path))
    ]
