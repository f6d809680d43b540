"""Syntax trees of source files, which several tests read."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

__all__ = ["syntax_tree"]


@cache
def syntax_tree(file: Path) -> ast.Module:
    """Parse a file once per process."""
    return ast.parse(file.read_text(encoding="utf-8"))
