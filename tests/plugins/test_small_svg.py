"""Drawings in fewer bytes are the same drawings: corners, dots, words and colours, read back from both."""

from __future__ import annotations

import base64
import re
from io import BytesIO
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from agglo_paper.small_svg import compress_svg

pytest.importorskip("matplotlib")

from matplotlib.figure import Figure
from PIL import Image

CORNERS = st.lists(st.tuples(*[st.floats(-500, 500).map(lambda x: round(x, 6))] * 2), min_size=2, max_size=30)


def drawn(draw: Any) -> tuple[str, str]:
    """A drawing as matplotlib writes it, and in fewer bytes."""
    figure, file = Figure(figsize=(4, 3)), BytesIO()
    draw(figure.subplots())
    figure.savefig(file, format="svg")
    svg = file.getvalue().decode()
    return svg, compress_svg(svg)


def subpaths(path: str) -> list[list[tuple[float, float]]]:
    """Corners of each subpath, as the SVG standard reads commands M, m, L, l, z and implicit lines."""
    words = re.findall(r"[MmLlz]|-?(?:\d+\.?\d*|\.\d+)", path)
    found: list[list[tuple[float, float]]] = []
    at, command, place = (0.0, 0.0), "", 0
    while place < len(words):
        if words[place].isalpha():
            command, place = words[place], place + 1
            if command == "z":
                at = found[-1][0]
            continue
        step = float(words[place]), float(words[place + 1])
        at = (at[0] + step[0], at[1] + step[1]) if command.islower() else step
        if command in "Mm":
            found.append([at])
            command = {"M": "L", "m": "l"}[command]
        else:
            found[-1].append(at)
        place += 2
    return found


@given(st.lists(st.tuples(CORNERS, st.booleans()), min_size=1, max_size=8))
def test_polylines_keep_their_corners(lines: list[tuple[list[tuple[float, float]], bool]]) -> None:
    words = []
    for corners, closed in lines:
        words += [f"{'L' if place else 'M'} {x:f} {y:f} " for place, (x, y) in enumerate(corners)]
        words += ["z "] if closed else []
    before = f'<path d="{"".join(words)}"/>'
    segments = [segments_of(compress_svg(before)), segments_of(before)]
    assert len(segments[0]) == len(segments[1])
    assert np.abs(np.subtract(*segments)).max() <= 0.0551


def segments_of(svg: str) -> np.ndarray:
    """Ends of all lines, in order."""
    paths = subpaths(re.findall(r' d="([^"]*)"', svg)[0])
    return np.array([(a, b) for path in paths for a, b in pairwise(path)])


def test_a_closed_loop_goes_on_from_its_first_corner() -> None:
    square = "M 0.000 0.000 L 9.000 0.000 L 9.000 9.000 z " * 5
    assert (
        segments_of(compress_svg(f'<path d="{square}"/>')).tolist()
        == segments_of(f'<path d="{square}"/>').tolist()
    )


def test_dots_keep_place_and_look() -> None:
    x = np.random.default_rng(0).random((2, 200))
    before, after = drawn(lambda axis: axis.scatter(*x, c=["C0", "C1"] * 100))
    here, there = (re.findall(r'<use [^>]*?x="([^"]*)" y="([^"]*)"', svg) for svg in (before, after))
    assert len(here) == len(there) >= 200
    assert np.abs(np.array(here, float) - np.array(there, float)).max() <= 0.0551
    assert len(after) < 0.6 * len(before)
    for colour in ("#1f77b4", "#ff7f0e"):
        assert colour in after


def test_labels_are_words() -> None:
    def draw(axis: Any) -> None:
        axis.set_xticks([0.0001, 0.0002], ["0.00512", "0.00498"])
        axis.set_title("1.23456")

    before, after = drawn(draw)
    for word in ("0.00512", "0.00498", "1.23456"):
        assert after.count(word) == before.count(word) > 0


def test_pictures_keep_their_colours_nearly() -> None:
    shades = np.zeros((40, 40, 3), np.uint8)
    shades[:20], shades[:, 20:] = (119, 170, 221), (238, 136, 102)
    before, after = drawn(lambda axis: axis.imshow(shades, interpolation="none"))
    here, there = (np.asarray(embedded(svg), int) for svg in (before, after))
    assert np.abs(here - there).max() <= 8


def embedded(svg: str) -> Any:
    found = re.findall(r'data:image/png;base64,([^"]+)"', svg)
    return Image.open(BytesIO(base64.b64decode(found[0]))).convert("RGBA")


def test_a_small_drawing_stays_as_it_is() -> None:
    after = drawn(lambda axis: axis.plot(np.random.default_rng(1).random(300), "o-"))[1]
    assert compress_svg(after) == after
