"""Links between the Markdown files lead somewhere, also from those outside of the site."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob(".github/**/*.md"), *(ROOT / "docs").rglob("*.md")])
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")
MADE = [ROOT / "build", ROOT / "docs" / "gallery" / "pictures", ROOT / "docs" / "notebooks" / "run"]
"""Folders that only a build of the site fills: a fresh clone does not have them."""
FENCE = re.compile(r"^( *)```.*?^\1```", re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_relative_link_leads_to_a_file(page: Path) -> None:
    targets = LINK.findall(FENCE.sub("", page.read_text(encoding="utf-8")))
    files = {(page.parent / target).resolve() for target in targets if "://" not in target}
    assert {file for file in files if not file.exists()} == set()
    assert {file for file in files if any(folder in file.parents for folder in MADE)} == set()


@pytest.mark.parametrize("picture", sorted((ROOT / "docs").glob("*/*.svg")), ids=lambda picture: picture.stem)
def test_drawings_are_small(picture: Path) -> None:
    assert picture.stat().st_size <= 200_000
