"""On any number of ranks distributed meshes hold what the whole mesh holds, to the last bit."""

from __future__ import annotations

import doctest
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from on_ranks import on_ranks

from agglo_core import Mesh, samples
from agglo_core.distributed import DistributedMesh, Ranks
from agglo_core.distributed.mesh import cell_values
from agglo_core.mesh.elements import gather

GEOMETRY = ("cell_measures", "cell_centroids", "local_centroids", "cell_diameters", "cell_inertias")


def meshes() -> Iterator[Mesh]:
    """Meshes of the kinds there are, cells without an order in space, with tags of cells and faces."""
    rng = np.random.default_rng(11)
    made = (
        samples.random_triangles(90, seed=5),
        samples.voronoi(120, seed=3),
        samples.tetrahedra(3),
        samples.boxes(3),
        samples.voronoi3d(40, seed=2),
    )
    for mesh in made:
        loops = as_lists(mesh, rng.permutation(mesh.n_cells))
        build: Any = Mesh.from_polygons if mesh.dim == 2 else Mesh.from_polyhedra
        built = build(mesh.points + 1000.0, loops, name="mixed")
        number, low = np.arange(built.n_faces), built.face_centroids.min() + 1e-9
        yield built.with_tags(half=lambda x: x[:, 0] < 1000.5, number=np.arange(mesh.n_cells)).with_face_tags(
            wall=(built.face_cells[:, 1] < 0) & (built.face_centroids.min(axis=1) < low),
            third=np.where(number % 3 == 0, number + 1, 0),
        )


def as_lists(mesh: Mesh, cells: np.ndarray) -> tuple[np.ndarray, ...]:
    """Cells as the lists that meshes are built from."""
    if mesh.dim == 2:
        loops = mesh.boundary_loops
        offsets, places = gather(loops.loop_offsets, cells)
        return offsets, loops.vertices[places]
    offsets, places = gather(mesh.cell_faces[0], cells)
    loop_offsets, entries = gather(mesh.face_offsets, mesh.cell_faces[1][places])
    return offsets, loop_offsets, mesh.face_vertices[entries]


def rebuilt(mesh: Mesh) -> Mesh:
    """The same mesh as the lists of its cells make it: faces and their loops may begin elsewhere."""
    build: Any = Mesh.from_polygons if mesh.dim == 2 else Mesh.from_polyhedra
    made: Mesh = build(mesh.points, as_lists(mesh, np.arange(mesh.n_cells)), cell_tags=mesh.cell_tags)
    return made


def compare(found: DistributedMesh, whole: Mesh, tagged: Mesh | None = None) -> None:
    """Own cells are those of the whole mesh; ghosts are their neighbours on other ranks, and nothing else.

    Tags of faces are those of the mesh ``tagged``.
    """
    found.check()
    local, own, ids = found.local, found.own, found.global_ids
    assert found.n_cells == whole.n_cells
    assert found.h == whole.h
    assert np.array_equal(found.exchange(ids[own]), ids)
    for name in GEOMETRY:
        assert np.array_equal(found.gather(getattr(local, name)[own]), getattr(whole, name)), name
        assert np.allclose(getattr(local, name), getattr(whole, name)[ids], rtol=1e-9, atol=1e-12), name
    assert local.cell_tags.keys() == whole.cell_tags.keys()
    for name, values in whole.cell_tags.items():
        assert np.array_equal(local.cell_tags[name], values[ids])
    ghosts = set()
    here, there = local.cell_neighbours, whole.cell_neighbours
    for cell in own:
        a = slice(here.indptr[cell], here.indptr[cell + 1])
        b = slice(there.indptr[ids[cell]], there.indptr[ids[cell] + 1])
        assert ids[here.indices[a]].tolist() == there.indices[b].tolist()
        assert np.array_equal(here.interface[a], there.interface[b])
        assert here.boundary[cell] == there.boundary[ids[cell]]
        ghosts |= set(there.indices[b].tolist()) - set(ids[own].tolist())
    assert sorted(ghosts) == np.delete(ids, own).tolist()
    compare_faces(found, tagged or whole)


def compare_faces(found: DistributedMesh, whole: Mesh) -> None:
    """Each face has the tags it has in the whole mesh, unless it leads to a cell that is not here."""

    def tagged(mesh: Mesh, ids: np.ndarray, faces: np.ndarray) -> list[tuple[Any, ...]]:
        sides = np.append(ids, -1)[mesh.face_cells[faces]]
        tags = [mesh.face_tags[name][faces] for name in sorted(mesh.face_tags)]
        length = mesh.face_measures[faces].round(9)
        return sorted(zip(*sides.T.tolist(), length.tolist(), *tags, strict=True))

    local, ids = found.local, found.global_ids
    sides = whole.face_cells
    here = np.isin(sides, [-1, *ids]).all(axis=1)
    assert tagged(local, ids, np.flatnonzero(~found.hidden)) == tagged(
        whole, np.arange(whole.n_cells), np.flatnonzero(here)
    )
    assert found.hidden.sum() == (np.isin(sides, ids).any(axis=1) & ~here).sum()
    assert not any(values[found.hidden].any() for values in local.face_tags.values())


def built_from(whole: Mesh, own: np.ndarray, ranks: Ranks, point_ids: np.ndarray | None) -> DistributedMesh:
    """The mesh from the cells that this rank gives, in the order given."""
    cells = as_lists(whole, own) if len(own) else []
    names = sorted(whole.face_tags)
    faces = np.flatnonzero(np.isin(whole.face_cells[:, 0], own))
    face_tags = {}
    for name in names if len(own) else []:
        listed = faces[whole.face_tags[name][faces] != 0]
        offsets, entries = gather(whole.face_offsets, listed)
        face_tags[name] = ((offsets, whole.face_vertices[entries]), whole.face_tags[name][listed])
    tags = {name: values[own] for name, values in whole.cell_tags.items()} if len(own) else None
    given: dict[str, Any] = {"cell_ids": own, "cell_tags": tags, "face_tags": face_tags}
    points = whole.points if len(own) else []
    if point_ids is None:
        return DistributedMesh.from_pieces(ranks, points, cells, **given)
    return DistributedMesh.from_local(ranks, points, cells, point_ids, **given)


def compare_all() -> None:
    ranks = Ranks()
    rng = np.random.default_rng(23)  # the same numbers on all ranks
    for whole in meshes():
        n, parts = whole.n_cells, 7
        for method in ("curve", "coordinates"):
            mesh = DistributedMesh.scatter(whole if ranks.rank == 0 else None, ranks, method)
            compare(mesh, whole)
            assert abs(len(mesh.own) - n / ranks.size) < 1
        rank_of = rng.integers(0, ranks.size, n)
        rank_of[rank_of == 1] = 0  # rank 1 of several has no cells
        moved = mesh.redistributed(rank_of[mesh.global_ids[mesh.own]])
        assert np.array_equal(moved.owners, rank_of[moved.global_ids])
        compare(moved, whole)
        own = np.random.default_rng(n).permutation(np.flatnonzero(rank_of == ranks.rank))
        lists = rebuilt(whole)
        for point_ids in (np.arange(whole.n_points)[::-1] * 5 - 3, None):
            compare(built_from(whole, own, ranks, point_ids), lists, whole)
        labels = rng.permutation(parts)[np.argsort(np.argsort(whole.cell_centroids[:, 0])) * parts // n]
        bounds = np.sort([0, parts, *rng.integers(0, parts + 1, ranks.size - 1)])
        coarse = moved.coarsen(labels[moved.global_ids[moved.own]], bounds)
        compare(coarse, whole.coarsen(labels))
        assert np.array_equal(coarse.global_ids[coarse.own], np.arange(*bounds[ranks.rank :][:2]))
        again = coarse.coarsen(coarse.global_ids[coarse.own] // 4, [0] * ranks.size + [2])  # on the last rank
        compare(again, whole.coarsen(labels).coarsen(np.arange(parts) // 4))


@pytest.mark.parametrize("size", [*(pytest.param(size, marks=pytest.mark.slow) for size in (1, 2, 4)), 3])
def test_meshes_do_not_depend_on_the_number_of_ranks(size: int) -> None:
    on_ranks(size, compare_all, seconds=100)


def test_the_examples_of_values_do_what_they_say() -> None:
    pytest.importorskip("mpi4py")
    found = doctest.testmod(cell_values)
    assert found.attempted
    assert not found.failed
