"""Solids in pyvista: pictures off the screen, sections, what the window offers, and what is refused."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agglo_core import agglomerate, samples
from agglo_core.errors import FileError, MeshError, OptionError
from agglo_core.hierarchy import Hierarchy


@pytest.fixture(scope="module")
def hierarchy() -> Hierarchy:
    return agglomerate(samples.boxes(4), bisector="coordinate", n_parts=(64, 8))


@pytest.fixture
def windows(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Plotters that were shown, off the screen."""
    pyvista = pytest.importorskip("pyvista", reason="pyvista is not installed")
    shown: list[Any] = []
    monkeypatch.setattr(pyvista, "OFF_SCREEN", True)
    monkeypatch.setattr(pyvista.Plotter, "show", lambda self: shown.append(self))
    return shown


def widgets(window: Any) -> Any:
    """Where a plotter has its widgets, which differs between versions of pyvista."""
    return getattr(window, "widgets", window)


def coloured(path: Path) -> np.ndarray:
    """Whether each pixel of a picture has a colour: neither grey nor white."""
    from matplotlib.image import imread

    return np.asarray(np.ptp(imread(path)[..., :3], axis=2) > 0.08)


def test_pictures_are_written_off_the_screen(hierarchy: Hierarchy, tmp_path: Path) -> None:
    pytest.importorskip("pyvista", reason="pyvista is not installed")
    pytest.importorskip("matplotlib")
    shares = []
    for name, given in {"a": {}, "b": {"explode": 1.0}, "c": {"section": (0, -1, 0)}}.items():
        path = tmp_path / f"{name}.png"
        hierarchy.view(1, path=path, **given)  # type: ignore[arg-type]
        shares.append(coloured(path).mean())
    assert min(shares) > 0.1
    assert sorted(each.name for each in tmp_path.iterdir()) == ["a.png", "b.png", "c.png"]


def test_the_window_has_sliders_for_level_and_explosion(hierarchy: Hierarchy, windows: list[Any]) -> None:
    hierarchy.view(explode=0.5)
    (window,) = windows
    sliders = {each.GetRepresentation().GetTitleText(): each for each in widgets(window).slider_widgets}
    level, explode = sliders["level"], sliders["explode"]
    assert level.GetRepresentation().GetMaximumValue() == 1.0
    assert explode.GetRepresentation().GetValue() == 0.5

    def shown() -> Any:
        return window.actors["parts"].mapper.dataset

    assert shown().n_cells == 64 * 6
    level.GetRepresentation().SetValue(1.0)
    level.InvokeEvent("EndInteractionEvent")
    assert shown().n_cells == 8 * 6 * 4
    assert shown().length == pytest.approx(3**0.5 * 1.25)
    explode.GetRepresentation().SetValue(0.0)
    explode.InvokeEvent("EndInteractionEvent")
    assert shown().length == pytest.approx(3**0.5)


def test_a_section_in_the_window_can_be_moved(hierarchy: Hierarchy, windows: list[Any]) -> None:
    hierarchy.view(section=(1, 0, 0))
    (window,) = windows
    assert len(widgets(window).plane_widgets) == 1
    assert not widgets(window).slider_widgets


def test_what_cannot_be_viewed_is_refused(
    hierarchy: Hierarchy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plane = agglomerate(samples.squares(4), bisector="coordinate", n_parts=2)
    bare = agglomerate(samples.boxes(2).graph, bisector="coordinate", n_parts=2)
    with pytest.raises(MeshError, match="view shows 3-D meshes"):
        plane.view()
    with pytest.raises(MeshError, match="belongs to a graph"):
        bare.view()
    with pytest.raises(IndexError, match=r"level 2 is out of range: the hierarchy has levels 0\.\.1"):
        hierarchy.view(2)
    with pytest.raises(OptionError, match="explode must be a number"):
        hierarchy.view(explode=-1)
    with pytest.raises(OptionError, match="section must be a direction"):
        hierarchy.view(section=(0, 0, 0))
    with pytest.raises(OptionError, match="explode cannot be combined with section"):
        hierarchy.view(explode=1, section=(1, 0, 0))
    with pytest.raises(FileError, match=r"end in \.png.*given '\.svg'"):
        hierarchy.view(path=tmp_path / "a.svg")
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(OptionError, match=r'pip install "agglo\[view\]"'):
        hierarchy.view(path=tmp_path / "a.png")


def test_without_a_display_a_picture_is_offered(
    hierarchy: Hierarchy, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pyvista", reason="pyvista is not installed")
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(OptionError, match="no display is available for a window; pass path="):
        hierarchy.view()


def test_a_view_that_cannot_be_written_leaves_nothing(hierarchy: Hierarchy, tmp_path: Path) -> None:
    pytest.importorskip("pyvista", reason="pyvista is not installed")
    with pytest.raises(FileError, match="cannot be written"):
        hierarchy.view(path=tmp_path / "nowhere" / "a.png")
    assert not list(tmp_path.iterdir())
