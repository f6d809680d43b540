"""Cells bounded by several shells: cavities, shells inside cavities, separate lumps, in every format."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain, pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray

from agglo_core import FileError, Mesh, MeshError, read, samples, write
from agglo_core.io.to_mesh.plain_cells import half_faces

Cell = list[list[int]]
SIDES = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))


def cubes(*spans: tuple[float, float], shift: float = 0.0) -> tuple[list[list[float]], list[Cell]]:
    """Corners of cubes [a, b]³, moved along x by ``shift``, and the faces of each, seen from outside."""
    points = [
        [x + shift, y, z] for a, b in spans for z in (a, b) for x, y in ((a, a), (b, a), (b, b), (a, b))
    ]
    return points, [[[8 * k + i for i in side] for side in SIDES] for k in range(len(spans))]


def turned_at_random(cell: Cell, rng: np.random.Generator) -> Cell:
    """The faces of a cell in any order and direction."""
    return [cell[i][:: rng.choice([1, -1])] for i in rng.permutation(len(cell))]


def listed(mesh: Mesh) -> list[Cell]:
    """Faces of every cell, seen from outside."""
    solids = half_faces(mesh)
    loops = [loop.tolist() for loop in np.split(solids.vertices, solids.loop_offsets[1:-1])]
    starts = solids.cell_offsets.tolist()
    return [loops[a:b] for a, b in pairwise(starts)]


def hollow(cavity: bool = False) -> Mesh:
    """A cube of 27 around one of its cubes, which is a cell too, or a cavity."""
    fine = samples.boxes(3)
    coarse = fine.coarsen((np.arange(27) == 13).astype(int))
    return Mesh.from_polyhedra(coarse.points, listed(coarse)[:1]) if cavity else coarse


# --- faces in any direction ---------------------------------------------------------------------------


def test_a_cavity_whatever_the_direction_of_its_faces() -> None:
    points, (outer, inner) = cubes((0, 3), (1, 2))
    inward = [face[::-1] for face in inner]
    rng = np.random.default_rng(0)
    for faces in (outer + inner, outer + inward, [outer[0][::-1], *outer[1:], *inner]):
        assert Mesh.from_polyhedra(points, [faces]).cell_measures == pytest.approx([26])
    for _ in range(20):
        mesh = Mesh.from_polyhedra(points, [turned_at_random(outer + inner, rng)])
        assert mesh.cell_measures == pytest.approx([26])
        assert mesh.cell_centroids == pytest.approx(np.full((1, 3), 1.5))
        away = (mesh.face_centroids - 1.5) * mesh.face_normals  # the cavity's faces look to its middle
        cavity = np.abs(mesh.face_centroids - 1.5).max(axis=1) < 1
        assert (away.sum(axis=1) < 0).tolist() == cavity.tolist()


def test_a_cell_in_a_cavity_is_a_neighbour() -> None:
    points, (outer, inner) = cubes((0, 3), (1, 2))
    mesh = Mesh.from_polyhedra(points, [outer + inner, inner])
    assert mesh.cell_measures == pytest.approx([26, 1])
    assert mesh.graph.interface.tolist() == [6, 6]


def test_shells_inside_cavities() -> None:
    points, shells = cubes((0, 7), (1, 6), (2, 5), (3, 4))
    whole = [*chain(*shells)]
    rng = np.random.default_rng(1)
    for _ in range(10):
        assert Mesh.from_polyhedra(points, [turned_at_random(whole, rng)]).cell_measures == pytest.approx(
            [244]
        )
    pair = [shells[0] + shells[1], shells[2] + shells[3]]
    assert Mesh.from_polyhedra(points, [whole]).cell_measures == pytest.approx([343 - 125 + 27 - 1])
    assert Mesh.from_polyhedra(points, pair).cell_measures == pytest.approx([343 - 125, 27 - 1])


def test_several_cavities_and_separate_lumps() -> None:
    points, (outer, *inner) = cubes((0, 9), (1, 2), (4, 5), (6, 8))
    other, (lump, hole) = cubes((0, 3), (1, 2), shift=20)
    whole = [*outer, *chain(*inner)] + [[v + len(points) for v in face] for face in lump + hole]
    rng = np.random.default_rng(2)
    for _ in range(10):
        mesh = Mesh.from_polyhedra(points + other, [turned_at_random(whole, rng)])
        assert mesh.cell_measures == pytest.approx([729 - 1 - 1 - 8 + 26])


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 6), st.sampled_from(["boxes", "tetrahedra", "Voronoi"]))
def test_scattered_parts_wound_at_random(seed: int, parts: int, kind: str) -> None:
    """Lumps, cavities, and shells that touch along edges and at vertices."""
    makers = {
        "boxes": lambda: samples.boxes(4),
        "tetrahedra": lambda: samples.tetrahedra(2),
        "Voronoi": lambda: samples.voronoi3d(40, seed=1),
    }
    fine, rng = makers[kind](), np.random.default_rng(seed)
    labels = np.unique(rng.integers(0, parts, fine.n_cells), return_inverse=True)[1]
    coarse = fine.coarsen(labels)
    again = Mesh.from_polyhedra(coarse.points, [turned_at_random(cell, rng) for cell in listed(coarse)])
    np.testing.assert_allclose(again.cell_measures, coarse.cell_measures, rtol=1e-9)
    np.testing.assert_allclose(again.cell_centroids, coarse.cell_centroids, atol=1e-9)


@pytest.mark.parametrize("scale", [1e-49, 1e40])
def test_cavities_do_not_depend_on_the_unit(scale: float) -> None:
    points, shells = cubes((0, 3), (1, 2))
    mesh = Mesh.from_polyhedra(np.multiply(points, scale), [[*chain(*shells)]])
    assert mesh.cell_measures / scale**3 == pytest.approx([26])


def test_a_lump_that_closes_in_on_a_cavity_by_edges_alone() -> None:
    """Six cubes around a void: every edge of the void has four faces of the cell."""
    boxes = samples.boxes(3)
    around = np.abs(np.round(boxes.cell_centroids * 3 - 1.5)).sum(axis=1) == 1
    coarse = boxes.coarsen(around.astype(int))
    rng = np.random.default_rng(3)
    for _ in range(10):
        mesh = Mesh.from_polyhedra(coarse.points, [turned_at_random(listed(coarse)[1], rng)])
        assert mesh.cell_measures == pytest.approx([6 / 27])


def test_shells_with_a_part_of_a_face_in_common_are_refused() -> None:
    points = cubes((0, 3))[0] + cubes((0, 1), shift=3)[0]
    both = cubes((0, 3), (0, 1))[1]
    with pytest.raises(MeshError, match="cell 0: the faces do not close, or cannot be oriented"):
        Mesh.from_polyhedra(points, [both[0] + both[1]])


# --- files --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".hedra", ".ovm", ".ele", ".mat", ".vtu", ".foam", ".npz"])
@pytest.mark.parametrize("cavity", [False, True])
def test_cells_around_others_and_cavities_come_back(suffix: str, cavity: bool, tmp_path: Path) -> None:
    mesh = hollow(cavity)
    write(tmp_path / f"m{suffix}", mesh)
    back = read(tmp_path / f"m{suffix}")
    assert back.cell_measures == pytest.approx(mesh.cell_measures)
    assert back.cell_measures[0] == pytest.approx(26 / 27)
    assert back.n_faces == mesh.n_faces == 60


def test_a_cavity_that_openfoam_lists_inside_out_is_refused(tmp_path: Path) -> None:
    mesh = hollow(cavity=True)
    inner = np.abs(mesh.face_centroids - 0.5).max(axis=1) < 0.3
    loops: NDArray[np.int64] = mesh.face_vertices.reshape(-1, 4).copy()
    loops[inner] = loops[inner, ::-1]
    write(tmp_path / "m.foam", replace(mesh, face_vertices=loops.ravel()))
    with pytest.raises(FileError, match="cell 0: the faces of a shell, such as a cavity, are oriented into"):
        read(tmp_path / "m.foam")
