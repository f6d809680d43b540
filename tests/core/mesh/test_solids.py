"""Kernels of solids against slow twins."""

from __future__ import annotations

from contextlib import suppress
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from agglo_core import Mesh, MeshError, samples
from agglo_core.arrays import frozen_float, frozen_int
from agglo_core.io.vtk.cells import _turns
from agglo_core.mesh.construction.polyhedra import _pair_by_sorting
from agglo_core.mesh.elements import turns_as_listed
from agglo_core.mesh.kernels.solid_cells import pair_half_faces, surfaces, vertices_of_solids

SEEDS = st.integers(0, 2**32 - 1)


def lumps(seed: int) -> Mesh:
    """Tetrahedra joined at random: solids of many faces, some loose, some with holes."""
    mesh, rng = samples.tetrahedra(2), np.random.default_rng(seed)
    return mesh.coarsen(np.unique(rng.integers(0, 1 + seed % 20, mesh.n_cells), return_inverse=True)[1])


def half_faces(mesh: Mesh):
    """Loops of all cells, turned and mirrored at random: cell of each, offsets, vertices."""
    offsets, faces = mesh.cell_faces
    rng = np.random.default_rng(mesh.n_cells)
    loops = [mesh.face_vertices[slice(*mesh.face_offsets[[f, f + 1]])] for f in faces]
    turned = [np.roll(loop, rng.integers(9))[:: rng.choice([-1, 1])] for loop in loops]
    ends = np.concatenate(([0], np.cumsum([len(loop) for loop in loops])))
    return np.repeat(np.arange(mesh.n_cells), np.diff(offsets)), frozen_int(ends), np.concatenate(turned)


@settings(max_examples=25, deadline=None)
@given(SEEDS)
def test_vertices_of_solids(seed: int) -> None:
    mesh = lumps(seed)
    offsets, faces = mesh.cell_faces
    shape = mesh.face_offsets, mesh.face_vertices, offsets, faces
    ends, vertices = vertices_of_solids(*shape, mesh.n_points)
    for c in range(mesh.n_cells):
        own = [
            mesh.face_vertices[slice(*mesh.face_offsets[[f, f + 1]])]
            for f in faces[slice(*offsets[[c, c + 1]])]
        ]
        assert vertices[slice(*ends[[c, c + 1]])].tolist() == np.unique(np.concatenate(own)).tolist()


@settings(max_examples=25, deadline=None)
@given(SEEDS)
def test_half_faces_are_paired_as_by_sorting(seed: int) -> None:
    mesh = samples.tetrahedra(2) if seed % 2 else samples.boxes(3)
    cell_of, offsets, vertices = half_faces(mesh)
    found = pair_half_faces(offsets, frozen_int(vertices), mesh.n_points)
    owner, partner = _pair_by_sorting(
        frozen_int(cell_of), offsets, frozen_int(vertices), np.arange(mesh.n_points)
    )
    assert np.flatnonzero(found >= -1).tolist() == owner.tolist()
    assert found[owner].tolist() == partner.tolist()
    assert sorted(np.flatnonzero(found == -2).tolist()) == sorted(partner[partner >= 0].tolist())


def test_three_faces_alike_are_no_pairs() -> None:
    loops = frozen_int([0, 1, 2, 1, 2, 0, 2, 1, 0])
    assert len(pair_half_faces(frozen_int([0, 3, 6, 9]), loops, 3)) == 0
    assert pair_half_faces(frozen_int([0, 3, 6]), loops[:6], 3).tolist() == [1, -2]


def test_surfaces() -> None:
    rng = np.random.default_rng(0)
    offsets, (vector, centre) = frozen_int([0, 4, 9]), map(frozen_float, rng.normal(size=(2, 9, 3)))
    for found, own in zip(surfaces(offsets, vector, centre), (slice(0, 4), slice(4, 9)), strict=True):
        flux = ((centre[own] - centre[own].mean(axis=0)) * vector[own]).sum(axis=1)
        lengths = np.linalg.norm(vector[own], axis=1).sum(), np.linalg.norm(vector[own].sum(axis=0))
        expected = [*lengths, flux.min(), flux.max(), flux.sum(), *centre[own].mean(axis=0)]
        np.testing.assert_allclose(found, expected)


@pytest.mark.parametrize(
    ("kind", "corners", "faces"), [("tetra", 4, 4), ("wedge", 6, 5), ("hexahedron", 8, 6)]
)
def test_turns_as_listed(kind: str, corners: int, faces: int) -> None:
    rng, n = np.random.default_rng(faces), 200
    turns = frozen_int(_turns(kind))
    first, second = map(frozen_int, rng.integers(0, corners, (2, n, faces)))
    own, ranks = rng.random((n, faces)) < 0.4, rng.integers(-1, faces, (8, 8))
    chosen = turns_as_listed(first, second, own, turns, frozen_int(ranks))
    for c in range(n):
        fits = []
        for t, turn in enumerate(turns.tolist()):
            place = [turn.index(corner) for corner in range(corners)]
            begins = zip(first[c][own[c]].tolist(), second[c][own[c]].tolist(), strict=True)
            listed = [-1, *(int(ranks[place[a], place[b]]) for a, b in begins)]
            fits += [t] if all(a < b for a, b in pairwise(listed)) else []
        assert chosen[c] == (fits[0] if fits else -1)
    assert len(set(chosen.tolist())) > 2


def test_many_faces_at_one_point_are_distinguished() -> None:
    fan = [[0, k, k + 1, 500] for k in range(1, 400)]  # all share an edge
    points = np.array(
        [[0, 0, 0], *([np.cos(k / 70), np.sin(k / 70), 0] for k in range(1, 500)), [0, 0, 1]], float
    )
    solids = [[[a, c, b], [a, b, d], [b, c, d], [a, d, c]] for a, b, c, d in fan]
    mesh = Mesh.from_polyhedra(points, solids)
    assert mesh.n_faces == 4 * 399 - 398
    with pytest.raises(MeshError, match="cells 0 and 399 are duplicates"):
        Mesh.from_polyhedra(points, [*solids, solids[0]])


DRAGGED = np.array(
    [(4, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)], float
)
"""Corners of a cube, one of them far outside: the volume depends on the vertex at which each face begins."""


@pytest.mark.parametrize("seed", range(20))
def test_warped_faces_never_enclose_a_negative_volume(seed: int) -> None:
    rng = np.random.default_rng(seed)
    loops = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
    turned = [np.roll(loop, rng.integers(4))[:: rng.choice((-1, 1))].tolist() for loop in loops]
    with suppress(MeshError):
        assert Mesh.from_polyhedra(DRAGGED, [turned]).cell_measures[0] > 0


def test_a_cell_that_warped_faces_turn_inside_out_is_refused() -> None:
    loops = [[0, 1, 2, 3], [5, 4, 7, 6], [0, 4, 5, 1], [1, 5, 6, 2], [6, 7, 3, 2], [0, 4, 7, 3]]
    with pytest.raises(MeshError, match="cell 0: the faces are too warped to enclose a positive volume"):
        Mesh.from_polyhedra(DRAGGED, [loops])
