"""Store cell tags and level labels in text files, in lines that other programs ignore."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping

import numpy as np

from agglo_core.arrays import Int, frozen_int
from agglo_core.errors import FileError
from agglo_core.files.text_numbers import integer_lines, integers, line_of

_TITLE = "cell data"
_COUNT = rb"cell data: (\d{1,9})[ \t\r]*(?=\n)"
_ROW = 16  # values per line


def tag_count(tags: Mapping[str, Int], prefix: str = "") -> str:
    """Return a line with the number of tags, by which :func:`find_tags` notices a truncated file.

    The line is empty without tags. Formats with comments have it before the points.
    """
    return f"{prefix}{_TITLE}: {len(tags)}\n" if tags else ""


def tag_lines(tags: Mapping[str, Int], prefix: str = "") -> str:
    """Return text with a title ``cell data "NAME"``, the value count, and the values of each tag.

    ``prefix`` begins every line, so that other programs treat it as a comment.
    """
    parts = []
    for name, values in tags.items():
        n = len(values)
        offsets = frozen_int(np.minimum(np.arange(0, n + _ROW, _ROW), n))
        forms = [prefix + " ".join(["%d"] * k) + "\n" for k in range(_ROW + 1)]
        parts.append(f"{prefix}{_TITLE} {json.dumps(name)}\n{prefix}{n}\n")
        parts.append(integer_lines(offsets, values, forms))
    return "".join(parts)


def find_tags(content: bytes, n_cells: int, prefix: str = "") -> dict[str, Int]:
    """Read the tags that :func:`tag_lines` has written into a text.

    Raises
    ------
    FileError
        If a tag is broken, its value count differs from the cell count, or there are fewer tags than
        :func:`tag_count` declares.
    """
    mark = re.escape(prefix.encode())
    values_of = re.compile(rb"(?:\n%b[-0-9 \t\r]*+(?=\n|\Z))*+" % mark)
    tags: dict[str, Int] = {}
    start = _next_title(content, prefix)
    while start < len(content):
        after = content.find(b"\n", start)
        after = len(content) if after < 0 else after
        name = _name(content[start + len(prefix) + len(_TITLE) : after], content, start)
        body = values_of.match(content, after)
        stop = body.end() if body is not None else after
        text = content[after:stop]
        values = integers(text.replace(prefix.encode(), b" ") if prefix else text)
        if not len(values) or values[0] != len(values) - 1 or len(values) - 1 != n_cells:
            raise FileError(f"cell data {name!r} has {max(len(values) - 1, 0)} values for {n_cells} cells")
        tags[name] = frozen_int(values[1:])
        start = _next_title(content, prefix, stop)
    declared = tags_declared(content, prefix)
    if declared is not None and declared != len(tags):
        line = line_of(content, len(content) - 1)
        raise FileError(f"line {line}: {declared} cell data are declared, but {len(tags)} found: truncated")
    return tags


def tags_declared(content: bytes, prefix: str = "") -> int | None:
    """Return the number of tags that the line of :func:`tag_count` declares, or None without the line."""
    place = content.find(f"{prefix}{_TITLE}: ".encode())  # faster than a pattern
    declared = re.compile(re.escape(prefix.encode()) + _COUNT).search(content, place) if place >= 0 else None
    return int(declared[1]) if declared is not None else None


def tags_begin(content: bytes) -> int:
    """Return the offset of the cell data in a text, or the text length."""
    places = [content.find(f"\n{_TITLE}{mark}".encode()) for mark in (": ", ' "')]
    return min((place + 1 for place in places if place >= 0), default=len(content))


def _next_title(content: bytes, prefix: str, start: int = 0) -> int:
    """Return the offset of the next line ``cell data "NAME"``, or the text length."""
    place = content.find(f'\n{prefix}{_TITLE} "'.encode(), max(start - 1, 0))
    return place + 1 if place >= 0 else len(content)


def _name(quoted: bytes, content: bytes, place: int) -> str:
    try:
        name = json.loads(quoted)
    except (ValueError, RecursionError):
        name = None
    if not isinstance(name, str):
        raise FileError(
            f"line {line_of(content, place)}: expected a quoted name of cell data, found {quoted[:30]!r}"
        )
    return name
