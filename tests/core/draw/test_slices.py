"""Solutions in 3-D on planes through the middle, and their picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from agglo_core import samples
from agglo_core.draw.solution import draw_solution, middle_slice
from agglo_core.problems.discretisation import Samples


def sampled(n_points: int, seed: int) -> Samples:
    """A linear function on random tetrahedra of the unit cube, each with points of its own."""
    mesh = samples.random_tetrahedra(n_points, seed=seed)
    corners = mesh.cell_vertices[1].reshape(-1, 4)
    points = mesh.points[corners].reshape(-1, 3)
    simplices = np.arange(len(points)).reshape(-1, 4)
    return Samples(simplices.ravel() // 4, points, simplices, points @ [1.0, 2.0, -3.0] + 0.5)


def areas(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    a, b = (points[triangles[:, k]] - points[triangles[:, 0]] for k in (1, 2))
    return np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("seed", range(4))
def test_a_slice_is_the_function_on_a_square(axis: int, seed: int) -> None:
    cut = middle_slice(sampled(60, seed), axis)
    assert areas(cut.points, cut.triangles).sum() == pytest.approx(1.0, abs=1e-12)
    whole = np.insert(cut.points, axis, 0.5, axis=1)
    np.testing.assert_allclose(cut.values, whole @ [1.0, 2.0, -3.0] + 0.5, atol=1e-12)


def test_faces_in_the_plane_are_cut_once() -> None:
    mesh = samples.tetrahedra(2)  # faces and points lie in the middle planes
    points = mesh.points[mesh.cell_vertices[1]]
    given = Samples(np.arange(len(points)) // 4, points, np.arange(len(points)).reshape(-1, 4), points[:, 0])
    cut = middle_slice(given, 2)
    assert areas(cut.points, cut.triangles).sum() == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(cut.values, cut.points[:, 0], atol=1e-12)


def test_solutions_of_solids_are_drawn(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    draw_solution(tmp_path / "a.png", sampled(30, 1))
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
