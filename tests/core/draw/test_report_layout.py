"""How the report looks in windows of several widths, enlarged, light and dark."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from browser import visited
from report_data import made

from agglo_core import samples
from agglo_core.draw.webpage import write_page
from agglo_core.measure.comparison import RunResult
from agglo_core.mesh import Mesh

WINDOWS = [(360, 1.0), (800, 1.0), (1400, 1.0), (800, 2.0), (1400, 2.0), (640, 2.0)]
"""Widths in pixels and how much the page is enlarged; the last is what accessibility asks for."""

OVERLAPS = """
  const kinds = "h1, h2, p, label, button, select, output, canvas, .scroll, figure, dl.words > *, #facts";
  const shown = [...document.querySelectorAll(kinds)]
    .filter((each) => each.checkVisibility() && !each.parentElement.closest(".scroll, figure"));
  const box = (each) => each.getBoundingClientRect();
  const found = [];
  shown.forEach((one, place) => shown.slice(place + 1).forEach((other) => {
    if (one.contains(other) || other.contains(one)) return;
    const [a, b] = [box(one), box(other)];
    const wide = Math.min(a.right, b.right) - Math.max(a.left, b.left);
    const high = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
    if (wide > 1 && high > 1) found.push([one.outerHTML.slice(0, 90), other.outerHTML.slice(0, 90)]);
  }));
  const cut = shown.filter((each) => box(each).right > innerWidth + 1 || box(each).left < -1);
  return { overlaps: found, cut: cut.map((each) => each.outerHTML.slice(0, 90)), count: shown.length,
    wide: document.documentElement.scrollWidth, window: innerWidth };"""

FAINT = """
  const numbers = (tone) => tone.match(/[\\d.]+/g).map(Number);
  const light = (tone) => numbers(tone).slice(0, 3).map((value) => value / 255)
    .map((value) => (value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4))
    .reduce((sum, value, k) => sum + value * [0.2126, 0.7152, 0.0722][k], 0);
  const behind = (each) => {
    for (let at = each; at; at = at.parentElement) {
      const tone = getComputedStyle(at).backgroundColor;
      if (numbers(tone)[3] !== 0) return tone;
    }
    return "rgb(255, 255, 255)";
  };
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT), seen = [];
  for (let node = walker.nextNode(); node; node = walker.nextNode()) {
    const each = node.parentElement, style = getComputedStyle(each);
    if (!node.data.trim() || !each.checkVisibility() || each.closest("script, style, :disabled, i")) continue;
    const tones = [light(each.closest("svg") ? style.fill : style.color), light(behind(each))];
    const contrast = (Math.max(...tones) + 0.05) / (Math.min(...tones) + 0.05);
    seen.push([contrast, `${node.data.slice(0, 40)} in ${each.outerHTML.slice(0, 40)}`]);
  }
  return seen;"""


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    plain = samples.voronoi(150, seed=3)
    tags = {"a tag of a rather long name": np.arange(plain.n_cells) // 20}
    mesh = Mesh(plain.points, plain.face_offsets, plain.face_vertices, plain.face_cells, tags, name="m" * 70)
    path = tmp_path_factory.mktemp("layout") / "report.html"
    failed = RunResult("broken", None, error="it said no")
    write_page(path, mesh, [made(mesh, "one", 8, 4), made(mesh, "r" * 40, 6), failed], note="a note " * 20)
    return path


@pytest.mark.parametrize(("width", "zoom"), WINDOWS)
def test_nothing_overlaps_or_sticks_out(page: Path, width: int, zoom: float) -> None:
    tag = "colour=tag:a+tag+of+a+rather+long+name"
    with visited(page, f"run=one&level=0&hover=3&{tag}&right={'r' * 40}", width=width, zoom=zoom) as tab:
        for two in (True, False):
            seen = tab.run(OVERLAPS)
            assert (seen["overlaps"], seen["cut"]) == ([], [])
            assert seen["wide"] <= seen["window"] == round(width / zoom)
            assert seen["count"] > 40
            if two:
                tab.run("document.getElementById('two').click();")
                tab.settle()


@pytest.mark.parametrize("dark", [False, True])
def test_texts_stand_out_light_and_dark(page: Path, dark: bool) -> None:
    with visited(page, "run=one&level=0&hover=3&colour=value:CR", dark=dark) as tab:
        for pressed in (False, True):
            seen = tab.run(FAINT)
            assert len(seen) > 100
            assert [text for contrast, text in seen if contrast < 4.5] == []
            paper = tab.run("return getComputedStyle(document.body).backgroundColor;")
            assert (paper == "rgb(255, 255, 255)") == (dark == pressed)
            name = tab.run("return document.getElementById('theme').textContent;")
            assert name == ("Dark" if dark == pressed else "Light")
            tab.run("document.getElementById('theme').click();")
            tab.settle()


def test_the_theme_changes_the_picture_of_the_mesh(page: Path) -> None:
    drawn = "return document.querySelector('.map').toDataURL();"
    with visited(page, "run=one&level=-1") as tab:
        light = tab.run(drawn)
        tab.run("document.getElementById('theme').click();")
        tab.settle()
        assert tab.run(drawn) != light


def test_what_can_be_done_can_be_reached_by_keys(page: Path) -> None:
    """Tab comes by all controls, and each tells that it has the focus, and its name."""
    with visited(page, "run=one&level=0") as tab:
        named = []
        for _ in range(14):
            tab.do("Input.dispatchKeyEvent", type="keyDown", key="Tab", code="Tab", windowsVirtualKeyCode=9)
            tab.do("Input.dispatchKeyEvent", type="keyUp", key="Tab", code="Tab", windowsVirtualKeyCode=9)
            named.append(
                tab.run("""const at = document.activeElement;
                  return [at.id || at.className, getComputedStyle(at).outlineStyle,
                    at.ariaLabel ?? at.textContent ?? "", at.labels?.length ?? 0];""")
            )
    wanted = [
        "theme",
        "colour",
        "cells",
        "two",
        "zoom-in",
        "zoom-out",
        "zoom-whole",
        "run",
        "level",
        "labels",
    ]
    names = [name for name, *_ in named]
    assert names[:12] == [*wanted, "map", "pick"]
    assert {outline for _, outline, *_ in named} == {"solid"}
    assert all(text.strip() or labels for _, _, text, labels in named)


COVERS = """
  const scrolled = [...document.querySelectorAll(".scroll")].filter((each) => each.scrollWidth > innerWidth);
  return scrolled.map((each) => getComputedStyle(each).backgroundAttachment);"""
NEIGHBOURS = """
  const texts = [...document.querySelectorAll("#boxes tfoot text")]
    .map((each) => each.getBoundingClientRect());
  return texts.slice(1).map((each, place) => each.left - texts[place].right);"""


@pytest.mark.parametrize("width", [400, 800])
def test_tables_that_scroll_have_a_shadow_and_axis_numbers_a_gap(page: Path, width: int) -> None:
    with visited(page, "run=one&level=0", width=width) as tab:
        assert set(tab.run(COVERS)) == {"local, local, scroll, scroll"}  # paper over shadows at the ends
        gaps = tab.run(NEIGHBOURS)
        assert len(gaps) > 10
        assert min(gaps) > 12.0


def test_wide_windows_show_the_box_plots_whole(page: Path) -> None:
    widths = "const {scrollWidth, clientWidth} = document.getElementById('boxes').parentElement;"
    for width, whole in ((800, True), (400, False)):
        with visited(page, width=width) as tab:
            assert tab.run(f"{widths} return scrollWidth <= clientWidth;") is whole
