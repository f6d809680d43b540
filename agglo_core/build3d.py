"""Polyhedral meshes: half-faces to faces, orientation, volumes and centroids (vectorised numpy)."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float, Index, Int, frozen_float, frozen_index, frozen_int
from agglo_core.build import check_indices, check_points, drop_orphans, merge_equal, name_cells
from agglo_core.errors import MeshError
from agglo_core.mesh import Mesh

__all__ = ["build_polyhedra", "face_moments", "polyhedron_moments", "polyhedron_vertices"]

_log = logging.getLogger("agglo")


def face_moments(points: Float, offsets: Int, vertices: Int) -> tuple[Float, Float]:
    """Area vectors and centroids of polygonal faces ``(F, 3)``, by fans of triangles."""
    sizes = np.diff(offsets)
    face = np.repeat(np.arange(len(sizes)), np.maximum(sizes - 2, 0))
    rank = np.arange(len(face)) - np.repeat(np.cumsum(sizes - 2) - (sizes - 2), sizes - 2)
    a = points[vertices[offsets[face]]]
    b = points[vertices[offsets[face] + rank + 1]]
    c = points[vertices[offsets[face] + rank + 2]]
    vector = 0.5 * np.cross(b - a, c - a)
    total = _sum_by(face, vector, len(sizes))
    length = np.linalg.norm(total, axis=1)
    unit = total / np.where(length > 0, length, 1.0)[:, None]
    share = (vector * unit[face]).sum(axis=1)
    centre = _sum_by(face, share[:, None] * (a + b + c) / 3.0, len(sizes))
    safe = np.where(length > 0, length, 1.0)[:, None]
    centre = np.where(length[:, None] > 0, centre / safe, points[vertices[offsets[:-1]]])
    return frozen_float(total), frozen_float(centre)


def _sum_by(groups: Int, values: Float, n: int) -> Float:
    columns = [np.bincount(groups, weights=column, minlength=n) for column in values.T]
    return np.stack(columns, axis=1)


def polyhedron_moments(mesh: Mesh) -> tuple[Float, Float]:
    """Volumes and centroids by the divergence theorem: pyramids over the faces."""
    vector, centre = face_moments(mesh.local_points, mesh.face_offsets, mesh.face_vertices)
    offsets, faces = mesh.cell_faces
    cells = np.repeat(np.arange(mesh.n_cells), np.diff(offsets))
    sign = np.where(mesh.face_cells[faces, 0] == cells, 1.0, -1.0)
    return _pyramids(cells, vector[faces] * sign[:, None], centre[faces], mesh.n_cells)


def _pyramids(cells: Int, vector: Float, centre: Float, n: int) -> tuple[Float, Float]:
    count = np.bincount(cells, minlength=n)[:, None]
    apex = _sum_by(cells, centre, n) / count
    arm = centre - apex[cells]
    volume = (arm * vector).sum(axis=1) / 3.0
    total = np.bincount(cells, weights=volume, minlength=n)
    moment = _sum_by(cells, 0.75 * volume[:, None] * arm, n)
    safe = np.where(total != 0, total, 1.0)[:, None]
    return frozen_float(total), frozen_float(apex + moment / safe)


def polyhedron_vertices(mesh: Mesh) -> tuple[Int, Index]:
    """Distinct vertices of each cell as CSR."""
    offsets, faces = mesh.cell_faces
    sizes = np.diff(mesh.face_offsets)[faces]
    start = np.cumsum(sizes) - sizes
    take = np.arange(sizes.sum()) + np.repeat(mesh.face_offsets[faces] - start, sizes)
    cells = np.repeat(np.repeat(np.arange(mesh.n_cells), np.diff(offsets)), sizes)
    keys = np.unique(cells * mesh.n_points + mesh.face_vertices[take])
    counts = np.bincount(keys // mesh.n_points, minlength=mesh.n_cells)
    return frozen_int(np.concatenate(([0], np.cumsum(counts)))), frozen_index(keys % mesh.n_points)


def build_polyhedra(
    points: ArrayLike,
    cells: Any,
    cell_tags: Mapping[str, ArrayLike],
    merge_points: bool,
    name: str,
) -> Mesh:
    """What :meth:`Mesh.from_polyhedra` does."""
    points = check_points(points)
    if points.shape[1] != 3:
        raise MeshError(f"polyhedra need points of shape (n_points, 3), not {points.shape}")
    cell_offsets, loop_offsets, vertices = _as_csr(cells)
    if len(cell_offsets) < 2:
        raise MeshError("the mesh is empty: it has no cells")
    few = np.flatnonzero(np.diff(cell_offsets) < 4)
    if len(few):
        raise MeshError(f"{name_cells(few)}: fewer than 4 faces")
    cell_of = np.repeat(np.arange(len(cell_offsets) - 1), np.diff(cell_offsets))
    few = np.flatnonzero(np.diff(loop_offsets) < 3)
    if len(few):
        raise MeshError(f"{name_cells(np.unique(cell_of[few]))}: a face with fewer than 3 vertices")
    check_indices(loop_offsets[cell_offsets], vertices, len(points), "cell")
    repairs: dict[str, int] = {}
    if merge_points:
        vertices, repairs["equal points merged"] = merge_equal(points, vertices)
    points, vertices, repairs["orphan points dropped"] = drop_orphans(points, vertices)
    local = frozen_float(points - 0.5 * (points.min(axis=0) + points.max(axis=0)))
    outward, repairs["faces turned outward"] = _outward(local, cell_of, loop_offsets, vertices)
    owner, neighbour = _match(cell_of, loop_offsets, vertices, len(points))
    keep_offsets, keep_vertices = _take_loops(loop_offsets, vertices, owner, outward[owner])
    repairs = {text: count for text, count in repairs.items() if count}
    for text, count in repairs.items():
        _log.info("%s: %d", text, count)
    sides = np.where(neighbour >= 0, cell_of[neighbour], -1)
    return Mesh(
        points=points,
        face_offsets=keep_offsets,
        face_vertices=keep_vertices,
        face_cells=np.stack((cell_of[owner], sides), axis=1),
        cell_tags={key: frozen_int(values) for key, values in cell_tags.items()},
        repairs=repairs,
        name=name,
    )


def _as_csr(cells: Any) -> tuple[Int, Int, Int]:
    if isinstance(cells, tuple) and len(cells) == 3 and isinstance(cells[0], np.ndarray):
        a, b, c = (frozen_int(part) for part in cells)
        return a, b, c
    try:
        counts = [len(cell) for cell in cells]
        loops = [np.asarray(loop) for cell in cells for loop in cell]
        flat = np.concatenate(loops) if loops else np.empty(0, np.int64)
    except (TypeError, ValueError) as error:
        raise MeshError(f"cells must be lists of faces, each a vertex loop: {error}") from None
    if flat.size and flat.dtype.kind not in "iu":
        raise MeshError(f"cells must hold integers (point numbers), not {flat.dtype}")
    sizes = [len(loop) for loop in loops]
    return (
        frozen_int(np.concatenate(([0], np.cumsum(counts, dtype=np.int64)))),
        frozen_int(np.concatenate(([0], np.cumsum(sizes, dtype=np.int64)))),
        frozen_int(flat),
    )


def _outward(points: Float, cell_of: Int, loop_offsets: Int, vertices: Int) -> tuple[Any, int]:
    """Whether each half-face as given points outward, and how many did not."""
    n = int(cell_of[-1]) + 1
    vector, centre = face_moments(points, loop_offsets, vertices)
    size = np.bincount(cell_of, weights=np.linalg.norm(vector, axis=1), minlength=n)

    def gap(signs: Float) -> Float:
        return np.asarray(np.linalg.norm(_sum_by(cell_of, vector * signs[:, None], n), axis=1))

    given = np.ones(len(cell_of))
    open_given = gap(given) > 1e-9 * size
    apex = _sum_by(cell_of, centre, n) / np.bincount(cell_of, minlength=n)[:, None]
    star = np.where(((centre - apex[cell_of]) * vector).sum(axis=1) < 0, -1.0, 1.0)
    sign = np.where(open_given[cell_of], star, given)
    still_open = np.flatnonzero(gap(sign) > 1e-9 * size)
    if len(still_open):
        raise MeshError(f"{name_cells(still_open)}: the faces do not close, or cannot be oriented")
    volume = _pyramids(cell_of, vector * sign[:, None], centre, n)[0]
    flat = np.flatnonzero(np.abs(volume) <= 1e-15 * size**1.5)
    if len(flat):
        raise MeshError(f"{name_cells(flat)}: zero volume")
    sign = sign * np.sign(volume)[cell_of]
    return sign > 0, int((sign < 0).sum())


def _match(cell_of: Int, loop_offsets: Int, vertices: Int, n_points: int) -> tuple[Int, Int]:
    """Half-faces paired by vertex set: owner half-face of each face, and its partner or −1."""
    sizes = np.diff(loop_offsets)
    owners, partners = [], []
    for size in np.unique(sizes):
        loops = np.flatnonzero(sizes == size)
        keys = np.sort(vertices[loop_offsets[loops][:, None] + np.arange(size)], axis=1)
        repeated = np.flatnonzero((np.diff(keys, axis=1) == 0).any(axis=1))
        if len(repeated):
            raise MeshError(f"{name_cells(np.unique(cell_of[loops[repeated]]))}: a face repeats a vertex")
        order = np.lexsort(np.concatenate((loops[None], keys.T[::-1])))
        new = np.concatenate(([True], (np.diff(keys[order], axis=0) != 0).any(axis=1)))
        start = np.flatnonzero(new)
        count = np.diff(np.append(start, len(order)))
        many = np.flatnonzero(count > 2)
        if len(many):
            cells = cell_of[loops[order[start[many[0]] : start[many[0]] + count[many[0]]]]]
            raise MeshError(f"a face has {len(cells)} cells: {', '.join(str(int(c)) for c in cells)}")
        owners.append(loops[order[start]])
        partners.append(np.where(count == 2, loops[order[np.minimum(start + 1, len(order) - 1)]], -1))
    owner, partner = np.concatenate(owners), np.concatenate(partners)
    order = np.argsort(owner)
    owner, partner = owner[order], partner[order]
    same = np.flatnonzero((partner >= 0) & (cell_of[owner] == cell_of[partner]))
    if len(same):
        raise MeshError(f"{name_cells(np.unique(cell_of[owner[same]]))}: the same face twice")
    _refuse_duplicates(cell_of, owner, partner)
    return frozen_int(owner), frozen_int(partner)


def _refuse_duplicates(cell_of: Int, owner: Int, partner: Int) -> None:
    """Two cells that share all their faces are the same cell."""
    inner = np.flatnonzero(partner >= 0)
    n = int(cell_of[-1]) + 1
    pairs, shared = np.unique(cell_of[owner[inner]] * n + cell_of[partner[inner]], return_counts=True)
    faces = np.bincount(cell_of, minlength=n)
    twins = np.flatnonzero((shared == faces[pairs // n]) & (shared == faces[pairs % n]))
    if len(twins):
        a, b = divmod(int(pairs[twins[0]]), n)
        raise MeshError(f"cells {a} and {b} are duplicates: they have the same faces")


def _take_loops(offsets: Int, vertices: Int, loops: Int, forward: Any) -> tuple[Int, Int]:
    sizes = np.diff(offsets)[loops]
    new = np.concatenate(([0], np.cumsum(sizes)))
    rank = np.arange(new[-1]) - np.repeat(new[:-1], sizes)
    mirrored = np.repeat(sizes, sizes) - 1 - rank
    rank = np.where(np.repeat(forward, sizes), rank, mirrored)
    return frozen_int(new), frozen_int(vertices[np.repeat(offsets[loops], sizes) + rank])
