"""Find coincident outer faces: candidates by centre and normal, then comparison by vertices."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int, Mask, frozen_float, frozen_int
from agglo_core.mesh.checks import box_centre
from agglo_core.mesh.derived import Derived
from agglo_core.mesh.elements import gather
from agglo_core.mesh.geometry.solid_cells import face_moments

_CHUNK = 50_000  # faces per chunk of candidates; larger: more memory, fewer trees (benchmarks/constants.py)
_OVERLAP = 1e-6  # share of the smaller face: minimum overlap, and tolerance for containment
_BESIDE = 8, 1e-3  # tolerance in units of reach over size of the smaller face, and its maximum
# Relative to the smaller radius: distance of a centre from the other plane (warped faces)
# (benchmarks/constants.py)
_LIFT = 0.3
_LAID = 3  # vertices of a tile that must lie on the edges of a warped face (benchmarks/constants.py)


class Outer(NamedTuple):
    """The m outer (boundary) faces of a mesh, with points relative to the bounding-box centre."""

    faces: Int  # (m,) numbers in the mesh
    used: Int  # numbers of their points in the mesh
    points: Float
    offsets: Int
    vertices: Int  # numbers into used
    centre: Float  # (m, d)
    normal: Float  # (m, d), 0 where the face has no measure
    measure: Float
    radius: Float  # largest distance of a vertex from the centre


class Contacts(NamedTuple):
    """Pairs of outer faces that coincide at least partially, with coincident and hanging points.

    Faces and points are numbered as in :class:`Outer`.
    """

    pairs: Int  # (k, 2) faces that coincide, at least partially
    share: Float  # (k, 2) share of each face covered by the other (3-D only)
    slack: Float  # (k,) tolerance of the shares due to rounding (3-D only)
    alike: Mask  # (k,) True if their vertices coincide (3-D only)
    distinct: Mask  # (k,) True if some coincident vertices have different numbers (3-D only)
    same: Int  # (p, 2) coincident points
    inside: Int  # (q, 2) an edge and a point in its interior (2-D only)
    along: Float  # (q,) distance of this point from the tail of the edge


def outer_faces(mesh: Derived) -> Outer:
    """Return the outer faces of a mesh: those with a cell on one side only."""
    # Outer faces with compact point numbers.
    faces = frozen_int(np.flatnonzero(mesh.face_cells[:, 1] < 0))
    start = mesh.face_offsets[faces]
    sizes = mesh.face_offsets[faces + 1] - start
    offsets = frozen_int(np.concatenate(([0], np.cumsum(sizes))))
    places = np.arange(offsets[-1]) + np.repeat(start - offsets[:-1], sizes)
    used_points, vertices = np.unique(mesh.face_vertices[places], return_inverse=True)
    points = mesh.points[used_points]
    points = frozen_float(points - box_centre(points) if len(used_points) else points)
    # Area vector and centre of each face.
    if mesh.dim == 2:
        tail, head = points[vertices[::2]], points[vertices[1::2]]
        edge, centre = head - tail, 0.5 * (head + tail)
        vector = np.stack((edge[:, 1], -edge[:, 0]), axis=1)
    else:
        vector, centre = face_moments(points, offsets, frozen_int(vertices))
    measure = _lengths(vector)
    reach = _lengths(points[vertices] - np.repeat(centre, sizes, axis=0))
    return Outer(
        faces,
        frozen_int(used_points),
        points,
        offsets,
        frozen_int(vertices),
        frozen_float(centre),
        frozen_float(vector / np.where(measure > 0, measure, 1.0)[:, None]),
        measure,
        frozen_float(np.maximum.reduceat(reach, offsets[:-1])),
    )


def _lengths(vectors: Float) -> Float:
    # einsum sums the short axis ten times faster than numpy.linalg.norm
    return frozen_float(np.sqrt(np.einsum("ij,ij->i", vectors, vectors)))


def facing_pairs(outer: Outer) -> Int:
    """Return pairs ``(k, 2)`` of outer faces that face each other and may coincide.

    The tree coordinates include the normal, negated in one tree, so convex domains have no candidates. Faces
    are grouped by size (powers of two), and each group is compared with all smaller faces.
    """
    pairs = [np.empty((0, 2), np.int64), *_candidates(outer)]
    return frozen_int(np.unique(np.sort(np.concatenate(pairs), axis=1), axis=0))


def _candidates(outer: Outer) -> Iterator[Int]:
    """Yield pairs of close outer faces with opposite normals, found by k-d trees."""
    from scipy.spatial import cKDTree

    real = np.flatnonzero(outer.measure > 0)
    power = np.frexp(outer.radius[real])[1]
    for level in np.unique(power):
        group, not_larger = real[power == level], real[power <= level]
        size = outer.radius[group].max()
        turn = 2 * size * outer.normal
        coordinates = np.concatenate((outer.centre, turn), axis=1)[group]
        partner_tree = cKDTree(np.concatenate((outer.centre, -turn), axis=1)[not_larger])
        for start in range(0, len(group), _CHUNK):
            tree = cKDTree(coordinates[start : start + _CHUNK])
            near = tree.sparse_distance_matrix(partner_tree, 2.05 * size, output_type="ndarray")
            i, j = group[near["i"] + start], not_larger[near["j"]]
            small = np.minimum(outer.radius[i], outer.radius[j])
            lift = np.einsum("ij,ij->i", outer.centre[j] - outer.centre[i], outer.normal[i])
            close = (np.abs(lift) <= _LIFT * small) & (i != j)
            yield frozen_int(np.stack((i[close], j[close]), axis=1))


def find_contacts(outer: Outer, pairs: Int, reach: Float) -> Contacts:
    """Return the face pairs that coincide within ``reach (k,)``, with overlaps and common points."""
    return _edges(outer, pairs, reach) if outer.points.shape[1] == 2 else _plates(outer, pairs, reach)


def _edges(outer: Outer, pairs: Int, reach: Float) -> Contacts:
    """Return edge pairs with a common segment longer than 2 ``reach`` and a gap within ``reach``."""
    # Common stretch in the coordinates of the first edge, and the gap at its ends.
    ends = outer.vertices.reshape(-1, 2)
    i, j = pairs.T
    position, offset = _coordinates_along_edges(outer, i, ends[j][:, ::-1])
    low, high = np.maximum(position[:, 0], 0), np.minimum(position[:, 1], outer.measure[i])
    length = position[:, 1] - position[:, 0]
    slope = (offset[:, 1] - offset[:, 0]) / np.where(length > 0, length, 1)
    gap = [np.abs(offset[:, 0] + slope * (at - position[:, 0])) for at in (low, high)]
    on = (high - low > 2 * reach) & (np.maximum(*gap) <= reach)
    pairs, reach = pairs[on], reach[on]
    # End points of each edge: at an end of the other edge, or in its interior.
    coincident, inside, inside_positions = [], [], []
    for edge, partner in (pairs.T, pairs.T[::-1]):
        position, offset = _coordinates_along_edges(outer, edge, ends[partner])
        size = outer.measure[edge]
        for k in range(2):
            at, is_near = position[:, k], np.abs(offset[:, k]) <= reach
            for end, distance in enumerate((at, at - size)):
                at_end = is_near & (np.abs(distance) <= reach)
                coincident.append(np.stack((ends[edge[at_end], end], ends[partner[at_end], k]), axis=1))
            in_interior = is_near & (at > reach) & (at < size - reach)
            inside.append(np.stack((edge[in_interior], ends[partner[in_interior], k]), axis=1))
            inside_positions.append(at[in_interior])
    return Contacts(
        pairs,
        frozen_float(np.zeros((len(pairs), 2))),
        frozen_float(np.zeros(len(pairs))),
        np.zeros(len(pairs), bool),
        np.zeros(len(pairs), bool),
        frozen_int(np.concatenate(coincident)),
        frozen_int(np.concatenate(inside)),
        frozen_float(np.concatenate(inside_positions)),
    )


def _coordinates_along_edges(outer: Outer, edge: Int, vertices: Int) -> tuple[Float, Float]:
    """Return tangential and normal coordinates of points ``vertices (k, n)`` relative to each edge."""
    normal = outer.normal[edge][:, None]
    step = outer.points[vertices] - outer.points[outer.vertices[2 * edge]][:, None]
    position = step[..., 1] * normal[..., 0] - step[..., 0] * normal[..., 1]
    return frozen_float(position), frozen_float((step * normal).sum(axis=2))


def _plates(outer: Outer, pairs: Int, reach: Float) -> Contacts:
    """Return contacts of 3-D faces: equal vertices, overlap of coplanar faces, tiles of warped faces."""
    # Count the vertices at a common location.
    row, first, second = _all_vertex_pairs(outer, pairs)
    gap = np.linalg.norm(outer.points[first] - outer.points[second], axis=1)
    near = gap <= reach[row]
    hits = np.bincount(row[near], minlength=len(pairs))
    sizes = np.diff(outer.offsets)[pairs]
    alike = (hits == sizes[:, 0]) & (hits == sizes[:, 1])
    size = outer.measure[pairs]
    ordered = frozen_int(np.where((size[:, 0] < size[:, 1])[:, None], pairs[:, ::-1], pairs))  # large, small
    # Coplanar faces, and tiles of a warped face, are compared by area.
    high, warp = _lifts(outer, ordered, row, first, second)
    flat = high <= reach
    warped = np.flatnonzero(~alike & ~flat & (high <= 1.01 * warp))
    flat[warped] = _on_edges(outer, frozen_int(ordered[warped]), reach[warped]) >= _LAID
    flat &= ~alike
    share = np.repeat(alike[:, None].astype(float), 2, axis=1)
    share[flat] = _shares(outer, frozen_int(pairs[flat]), outer.normal[ordered[flat, 0]])
    # Accept pairs whose common area exceeds the tolerance.
    slack = np.minimum(_BESIDE[0] * reach / np.sqrt(size.min(axis=1)), _BESIDE[1])
    slack = np.maximum(slack, _OVERLAP)
    is_contact = share.max(axis=1, initial=0) > slack
    distinct = np.bincount(row[near & (first != second)], minlength=len(pairs)) > 0
    return Contacts(
        frozen_int(pairs[is_contact]),
        frozen_float(share[is_contact]),
        frozen_float(slack[is_contact]),
        alike[is_contact],
        distinct[is_contact],
        frozen_int(np.stack((first, second), axis=1)[near & is_contact[row]]),
        frozen_int(np.empty((0, 2))),
        frozen_float([]),
    )


def _lifts(outer: Outer, ordered: Int, row: Int, first: Int, second: Int) -> tuple[Float, Float]:
    """Return the largest distance of vertices from the mean plane of each pair's larger face.

    The first array is for both faces, the second for the larger face alone.
    """
    large = ordered[row, 0]
    high, warp = np.zeros(len(ordered)), np.zeros(len(ordered))
    for vertices in (first, second):
        lift = ((outer.points[vertices] - outer.centre[large]) * outer.normal[large]).sum(axis=1)
        np.maximum.at(high, row, np.abs(lift))
    rows, vertices, _ = _all_vertex_pairs(outer, ordered)
    lift = ((outer.points[vertices] - outer.centre[large]) * outer.normal[large]).sum(axis=1)
    np.maximum.at(warp, rows, np.abs(lift))
    return frozen_float(high), frozen_float(warp)


def _on_edges(outer: Outer, ordered: Int, reach: Float) -> Int:
    """Count the vertices of each second face that lie on an edge of the first face."""
    # Pair each edge of the first face with each vertex of the second.
    following = np.arange(1, len(outer.vertices) + 1)
    following[outer.offsets[1:] - 1] = outer.offsets[:-1]
    offsets, edge = gather(outer.offsets, frozen_int(ordered[:, 0]))
    row = np.repeat(np.arange(len(ordered)), np.diff(offsets))
    ends, vertex = gather(outer.offsets, frozen_int(ordered[row, 1]))
    times = np.diff(ends)
    row, edge = np.repeat(row, times), np.repeat(edge, times)
    # Distance from the edge as a segment.
    tail, head = (outer.points[outer.vertices[places]] for places in (edge, following[edge]))
    edge_vector, step = head - tail, outer.points[outer.vertices[vertex]] - tail
    at = (step * edge_vector).sum(axis=1) / np.maximum(
        (edge_vector * edge_vector).sum(axis=1), np.finfo(float).tiny
    )
    distance = np.linalg.norm(step - np.clip(at, 0, 1)[:, None] * edge_vector, axis=1)
    rows = np.unique(np.stack((row, vertex))[:, distance <= reach[row]], axis=1)[0]
    return frozen_int(np.bincount(rows, minlength=len(ordered)))


def _all_vertex_pairs(outer: Outer, pairs: Int) -> tuple[Int, Int, Int]:
    """Combine all vertices in each face pair: pair index, first vertex, second vertex."""
    offsets, places = gather(outer.offsets, frozen_int(pairs[:, 0]))
    row = np.repeat(np.arange(len(pairs)), np.diff(offsets))
    ends, partner_places = gather(outer.offsets, frozen_int(pairs[row, 1]))
    times = np.diff(ends)
    return (
        frozen_int(np.repeat(row, times)),
        frozen_int(np.repeat(outer.vertices[places], times)),
        frozen_int(outer.vertices[partner_places]),
    )


def _shares(outer: Outer, pairs: Int, normal: Float) -> Float:
    """Return the overlap of two faces, as fractions ``(k, 2)``, seen along ``normal (k, 3)``."""
    import shapely

    if not len(pairs):
        return frozen_float(np.empty((0, 2)))
    axis = np.eye(3)[np.abs(normal).argmin(axis=1)]
    right = np.cross(axis, normal)
    right /= np.linalg.norm(right, axis=1)[:, None]
    frame = np.stack((right, np.cross(normal, right)), axis=2)  # (k, 3, 2)
    plates = []
    for side in pairs.T:
        offsets, places = gather(outer.offsets, frozen_int(side))
        row = np.repeat(np.arange(len(pairs)), np.diff(offsets))
        step = outer.points[outer.vertices[places]] - outer.centre[pairs[row, 0]]
        flat = np.einsum("ni,nij->nj", step, frame[row]) / outer.radius[pairs[row, 0]][:, None]
        plates.append(shapely.make_valid(shapely.polygons(shapely.linearrings(flat, indices=row))))
    shared = shapely.area(shapely.intersection(*plates))
    return frozen_float(np.stack([shared / shapely.area(plate) for plate in plates], axis=1))
