"""Pictures of solids: what is seen from a side, that parts hide what is behind them, their colours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from agglo_core import agglomerate, samples
from agglo_core.arrays import frozen_float, frozen_int
from agglo_core.draw.colours import rgb
from agglo_core.draw.plot import draw
from agglo_core.draw.solids.depth_buffer import nearest_faces
from agglo_core.draw.solids.shading import brightness, shade_faces
from agglo_core.draw.solids.surfaces import SIDE, axes_of, mark_cells_beyond, outer_faces, project_surface
from agglo_core.errors import OptionError
from agglo_core.hierarchy import Hierarchy
from agglo_core.mesh import Mesh


def inside(point: np.ndarray, loop: np.ndarray) -> bool:
    """Whether a point of the plane lies within a loop: its winding number, by angles."""
    spokes = loop - point
    ahead = np.roll(spokes, -1, axis=0)
    turns = np.arctan2(spokes[:, 0] * ahead[:, 1] - spokes[:, 1] * ahead[:, 0], (spokes * ahead).sum(axis=1))
    return abs(turns.sum()) > np.pi


def slow_twin(loops: list[np.ndarray], planes: np.ndarray, width: int, height: int) -> np.ndarray:
    """The nearest face at each pixel, pixel by pixel and face by face."""
    nearest, depth = np.full((height, width), -1), np.full((height, width), -np.inf)
    for row in range(height):
        for column in range(width):
            point = np.array([column + 0.5, row + 0.5])
            for face, (loop, plane) in enumerate(zip(loops, planes, strict=True)):
                z = np.clip(plane @ [1.0, *point], loop[:, 2].min(), loop[:, 2].max())
                if inside(point, loop[:, :2]) and z > depth[row, column]:
                    nearest[row, column], depth[row, column] = face, z
    return nearest


def star(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A loop of 3 to 9 corners that is seldom convex, and the plane that it lies in."""
    angles = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 10)))
    xy = rng.uniform(0, 10, 2) + rng.uniform(1, 8, len(angles))[:, None] * np.stack(
        (np.cos(angles), np.sin(angles)), axis=1
    )
    plane = rng.normal(size=3)
    return np.column_stack((xy, plane[0] + xy @ plane[1:])), plane


@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_the_nearest_face_is_seen(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    loops, planes = zip(*(star(rng) for _ in range(count)), strict=True)
    offsets = frozen_int(np.cumsum([0, *map(len, loops)]))
    given_planes, corners = frozen_float(np.array(planes)), frozen_float(np.concatenate(loops))
    found, depth = nearest_faces(corners, offsets, frozen_int(np.arange(count)), given_planes, 9, 7)
    np.testing.assert_array_equal(found, slow_twin(list(loops), np.array(planes), 9, 7))
    np.testing.assert_array_equal(np.isneginf(depth), found < 0)


def test_faces_that_share_an_edge_leave_no_gap_and_no_overlap() -> None:
    grid = samples.voronoi(150, seed=3)
    loops, turn = grid.boundary_loops, np.array([[0.8, 0.6], [-0.6, 0.8]])
    placed = 30 * (grid.points[loops.vertices] - 0.5) @ turn + 30
    counts = np.zeros((60, 60), int)
    corners = frozen_float(np.column_stack((placed, np.zeros(len(placed)))))
    planes = frozen_float(np.zeros((150, 3)))
    for face in range(150):
        one = frozen_int([face])
        counts += nearest_faces(corners, frozen_int(loops.loop_offsets), one, planes, 60, 60)[0] >= 0
    assert counts.max() == 1
    assert counts.sum() == pytest.approx(900, abs=20)
    x, y = np.meshgrid(np.arange(60) + 0.5, np.arange(60) + 0.5)
    within = np.abs((np.stack((x, y), axis=2) - 30) @ turn.T).max(axis=2) < 15 - 1e-6
    assert (counts[within] == 1).all()


def test_faces_that_are_not_convex_hide_no_more_than_they_are() -> None:
    mesh = samples.boxes(3)
    labels = (mesh.cell_centroids[:, 0] + mesh.cell_centroids[:, 1] > 1.1).astype(int)  # an L from above
    simple = mesh.coarsen(labels).simplified()
    assert np.diff(simple.face_offsets).max() > 4
    fine, coarse = outer_faces(mesh, labels), outer_faces(simple, np.arange(2))
    above = (-90.0, 89.9)
    seen_fine, seen_coarse = project_surface(fine, above, 200), project_surface(coarse, above, 200)
    parts = [
        np.append(each.parts, -1)[sight.faces] for each, sight in ((fine, seen_fine), (coarse, seen_coarse))
    ]
    assert set(np.unique(parts[0])) == {-1, 0, 1}
    assert (parts[0] != parts[1]).mean() < 1e-3


def test_outer_faces_of_parts_are_those_between_them() -> None:
    mesh = samples.boxes(2)
    assert len(outer_faces(mesh, np.arange(8)).parts) == 48
    assert len(outer_faces(mesh, np.zeros(8, int)).parts) == 24
    halves = outer_faces(mesh, (mesh.cell_centroids[:, 0] > 0.5).astype(int))
    np.testing.assert_array_equal(np.bincount(halves.parts), [16, 16])
    half = outer_faces(mesh, np.zeros(8, int), kept=~mark_cells_beyond(mesh, (1.0, 0.0, 0.0)))
    assert len(half.parts) == 16
    assert half.corners[:, 0].max() == 0.0
    assert (mesh.cell_centroids[half.cells, 0] < 0.5).all()


@pytest.mark.parametrize("explode", [0.0, 0.5, 2.0])
def test_parts_move_by_the_factor_and_keep_their_shape(explode: float) -> None:
    mesh = samples.voronoi3d(60, seed=1)
    labels = agglomerate(mesh, n_parts=7).levels[0]
    still, moved = outer_faces(mesh, labels), outer_faces(mesh, labels, explode)
    centres = np.stack([np.average(mesh.cell_centroids[labels == p], axis=0,
                                   weights=mesh.cell_measures[labels == p]) for p in range(7)])  # fmt: skip
    whole = np.average(mesh.cell_centroids, axis=0, weights=mesh.cell_measures)
    way = np.repeat(still.parts, np.diff(still.offsets))
    np.testing.assert_allclose(moved.corners - still.corners, explode * (centres - whole)[way], atol=1e-12)


def test_normals_point_out_of_the_parts() -> None:
    mesh = samples.voronoi3d(40, seed=2)
    surface = outer_faces(mesh, np.arange(40))
    sizes = np.diff(surface.offsets)
    middle = np.add.reduceat(surface.corners, surface.offsets[:-1]) / sizes[:, None]
    away = middle - mesh.local_centroids[surface.cells]  # convex cells
    assert (np.einsum("ij,ij->i", away, surface.normals) > 0.0).all()


def test_three_sides_of_a_cube_are_seen_in_their_proportions() -> None:
    surface = outer_faces(samples.boxes(1), np.zeros(1, int))
    sight = project_surface(surface, SIDE, 400)
    numbers, pixels = np.unique(sight.faces[sight.faces >= 0], return_counts=True)
    facing = surface.normals @ axes_of(*SIDE)[2]
    np.testing.assert_array_equal(numbers, np.flatnonzero(facing > 1e-9))
    np.testing.assert_allclose(pixels / pixels.sum(), facing[numbers] / facing[numbers].sum(), atol=0.005)
    assert max(sight.faces.shape) == 400
    top = surface.normals[sight.faces[20, sight.faces.shape[1] // 2]]
    np.testing.assert_allclose(top, [0, 0, 1], atol=1e-12)  # row 0 is above
    assert (
        project_surface(surface, (0.0, 0.0), 50).faces.max()
        == project_surface(surface, (0.0, 0.0), 50).faces[25, 25]
    )


def test_what_is_behind_is_hidden() -> None:
    mesh = samples.boxes(3)
    surface = outer_faces(mesh, np.arange(27), 0.5)
    sight = project_surface(surface, (0.0, 0.0), 300)
    front = surface.parts[np.unique(sight.faces[sight.faces >= 0])]
    assert (mesh.cell_centroids[front, 0] > 0.7).all()
    assert len(np.unique(front)) == 9


def test_lights_and_lines(tmp_path: Path) -> None:
    mesh = samples.boxes(2)
    surface = outer_faces(mesh, (mesh.cell_centroids[:, 2] > 0.5).astype(int))
    sight = project_surface(surface, SIDE, 300)
    bright = brightness(surface, sight)
    assert 0.5 <= bright.min() < bright.max() <= 1.0
    tones = np.array([rgb("#ff0000"), rgb("#0000ff")])
    picture = shade_faces(surface, sight, tones[surface.parts], 2)
    assert picture.shape == (*sight.faces.shape, 4)
    assert picture.dtype == np.uint8
    there = sight.faces >= 0
    assert (picture[..., 3] > 0)[there].all()
    assert (picture[..., 3] == 0).sum() > 0.9 * (~there).sum()
    red, blue = (picture[..., k].astype(int) - picture[..., 2 - k] > 60 for k in (0, 2))
    rows = np.arange(picture.shape[0])[:, None] * np.ones(picture.shape[:2])
    assert rows[blue].mean() < rows[red].mean() - 50
    assert red.sum() + blue.sum() > 0.8 * there.sum()


def test_solids_are_drawn(tmp_path: Path) -> None:
    mesh, path = samples.layered(4), tmp_path / "a.svg"
    hierarchy = agglomerate(mesh, cells_per_part=(4, 16), regions="material")
    draw(mesh, {"one": hierarchy, "two": hierarchy}, path, explode=0.5, section=(0, -1, 0))
    assert path.read_bytes()[:4] == b"<?xm"
    assert list(tmp_path.iterdir()) == [path]


def test_titles_of_solids_have_means_that_exist_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    titles: list[str] = []
    monkeypatch.setattr("agglo_core.draw.plot._entitle", lambda axis, title: titles.append(title))
    mesh = samples.boxes(2)
    labels = (mesh.cell_centroids[:, 0] > 0.5).astype(int)
    halves = Hierarchy(mesh, mesh.graph, [labels], [{"n_parts": 2}], nested=True)
    draw(mesh, {"run": halves}, tmp_path / "a.png")
    assert titles[1].startswith("run\n2 parts\nUF 1.00   CR 0.33")


def _whole(mesh: Mesh) -> Hierarchy:
    return Hierarchy(mesh, mesh.graph, [np.zeros(mesh.n_cells, int)], [{}], nested=True)


@pytest.mark.parametrize("explode", [-0.1, 11, np.nan, "much", True])
def test_factors_that_make_no_sense_are_refused(tmp_path: Path, explode: object) -> None:
    mesh = samples.boxes(1)
    with pytest.raises(OptionError, match="explode must be a number from 0"):
        draw(mesh, {"run": _whole(mesh)}, tmp_path / "a.png", explode=explode)  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("section", [(0, 0, 0), (1, 0), (np.inf, 0, 0)])
def test_sections_that_are_no_direction_are_refused(tmp_path: Path, section: tuple[float, ...]) -> None:
    mesh = samples.boxes(1)
    with pytest.raises(OptionError, match="section must be a direction, three numbers not all 0"):
        draw(mesh, {"run": _whole(mesh)}, tmp_path / "a.png", section=section)


@pytest.mark.parametrize("given", [{"explode": 0.5}, {"section": (1, 0, 0)}])
def test_explode_and_section_are_refused_for_plane_meshes(tmp_path: Path, given: dict[str, object]) -> None:
    mesh = samples.squares(2)
    with pytest.raises(OptionError, match=r"applies to 3-D meshes; squares 2x2 is 2-D"):
        draw(mesh, {"run": _whole(mesh)}, tmp_path / "a.png", **given)  # type: ignore[arg-type]
