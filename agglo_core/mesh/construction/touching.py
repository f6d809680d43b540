"""Outer faces that lie on one another: candidates by centre and normal, then compared vertex by vertex."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int, Mask, frozen_float, frozen_int
from agglo_core.mesh.checks import box_centre
from agglo_core.mesh.derived import Derived
from agglo_core.mesh.elements import gather
from agglo_core.mesh.geometry.solid_cells import face_moments

_CHUNK = 50_000  # faces whose candidates are held at once
_OVERLAP = 1e-6  # of the smaller face: what faces must share to overlap, and may lack to lie within
_BESIDE = 8, 1e-3  # the same in units of the reach over the size of the smaller face, and at most
_LIFT = 0.3  # of the smaller radius: how far a centre may be off the plane of the other, as faces are warped
_LAID = 3  # vertices of a tile of a warped face that lie on its edges


class Outer(NamedTuple):
    """The m outer faces of a mesh; points are those on them, relative to the middle of their box."""

    faces: Int  # (m,) numbers in the mesh
    used: Int  # points of the mesh that they use
    points: Float
    offsets: Int
    vertices: Int  # numbers into used
    centre: Float  # (m, d)
    normal: Float  # (m, d), 0 where the face has no measure
    measure: Float
    radius: Float  # no vertex is farther from the centre


class Contacts(NamedTuple):
    """Contacts of outer faces; faces and points are numbered as in :class:`Outer`."""

    pairs: Int  # (k, 2) faces that lie on one another, at least in part
    share: Float  # (k, 2) how much of either lies on the other (3-D only)
    slack: Float  # (k,) by how much that may be off, as points are rounded (3-D only)
    alike: Mask  # (k,) whether their vertices are at the same places (3-D only)
    distinct: Mask  # (k,) whether some points of theirs at one place are not the same point (3-D only)
    same: Int  # (p, 2) points that are one
    inside: Int  # (q, 2) an edge and a point in its interior (2-D only)
    along: Float  # (q,) how far that point is from the tail of the edge


def outer_faces(mesh: Derived) -> Outer:
    """The faces of a mesh with a cell on one side only."""
    faces = frozen_int(np.flatnonzero(mesh.face_cells[:, 1] < 0))
    start = mesh.face_offsets[faces]
    sizes = mesh.face_offsets[faces + 1] - start
    offsets = frozen_int(np.concatenate(([0], np.cumsum(sizes))))
    places = np.arange(offsets[-1]) + np.repeat(start - offsets[:-1], sizes)
    used, vertices = np.unique(mesh.face_vertices[places], return_inverse=True)
    points = mesh.points[used]
    points = frozen_float(points - box_centre(points) if len(used) else points)
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
        frozen_int(used),
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
    """Pairs ``(k, 2)`` of outer faces that look at each other and may lie on one another.

    The normal is part of the coordinates of the trees, turned round in one of them: convex domains have
    no candidates at all. Faces are taken by powers of two of their size, each with all smaller ones.
    """
    found = [np.empty((0, 2), np.int64), *_candidates(outer)]
    return frozen_int(np.unique(np.sort(np.concatenate(found), axis=1), axis=0))


def _candidates(outer: Outer) -> Iterator[Int]:
    """Yield pairs of near outer faces with opposite normals, from trees of centre and scaled normal."""
    from scipy.spatial import cKDTree

    real = np.flatnonzero(outer.measure > 0)
    power = np.frexp(outer.radius[real])[1]
    for level in np.unique(power):
        own, others = real[power == level], real[power <= level]
        size = np.ldexp(1.0, int(level))  # no radius of these is larger
        turn = 2 * size * outer.normal
        here = np.concatenate((outer.centre, turn), axis=1)[own]
        there = cKDTree(np.concatenate((outer.centre, -turn), axis=1)[others])
        for start in range(0, len(own), _CHUNK):
            tree = cKDTree(here[start : start + _CHUNK])
            near = tree.sparse_distance_matrix(there, 2.05 * size, output_type="ndarray")
            i, j = own[near["i"] + start], others[near["j"]]
            small = np.minimum(outer.radius[i], outer.radius[j])
            lift = np.einsum("ij,ij->i", outer.centre[j] - outer.centre[i], outer.normal[i])
            close = (np.abs(lift) <= _LIFT * small) & (i != j)
            yield frozen_int(np.stack((i[close], j[close]), axis=1))


def find_contacts(outer: Outer, pairs: Int, reach: Float) -> Contacts:
    """Mask of the pairs that lie on one another within ``reach (k,)``, a length for each pair."""
    return _edges(outer, pairs, reach) if outer.points.shape[1] == 2 else _plates(outer, pairs, reach)


def _edges(outer: Outer, pairs: Int, reach: Float) -> Contacts:
    """Edges whose common stretch is longer than twice the reach and within reach at both its ends."""
    ends = outer.vertices.reshape(-1, 2)
    i, j = pairs.T
    far, off = _beside(outer, i, ends[j][:, ::-1])
    low, high = np.maximum(far[:, 0], 0), np.minimum(far[:, 1], outer.measure[i])
    length = far[:, 1] - far[:, 0]
    slope = (off[:, 1] - off[:, 0]) / np.where(length > 0, length, 1)
    gap = [np.abs(off[:, 0] + slope * (at - far[:, 0])) for at in (low, high)]
    on = (high - low > 2 * reach) & (np.maximum(*gap) <= reach)
    pairs, reach = pairs[on], reach[on]
    same, inside, along = [], [], []
    for edge, other in (pairs.T, pairs.T[::-1]):
        far, off = _beside(outer, edge, ends[other])
        size = outer.measure[edge]
        for k in range(2):
            at, beside = far[:, k], np.abs(off[:, k]) <= reach
            for end, distance in enumerate((at, at - size)):
                one = beside & (np.abs(distance) <= reach)
                same.append(np.stack((ends[edge[one], end], ends[other[one], k]), axis=1))
            within = beside & (at > reach) & (at < size - reach)
            inside.append(np.stack((edge[within], ends[other[within], k]), axis=1))
            along.append(at[within])
    return Contacts(
        pairs,
        frozen_float(np.zeros((len(pairs), 2))),
        frozen_float(np.zeros(len(pairs))),
        np.zeros(len(pairs), bool),
        np.zeros(len(pairs), bool),
        frozen_int(np.concatenate(same)),
        frozen_int(np.concatenate(inside)),
        frozen_float(np.concatenate(along)),
    )


def _beside(outer: Outer, edge: Int, vertices: Int) -> tuple[Float, Float]:
    """Coordinates of the points ``vertices (k, n)`` along each edge, and distances from its line."""
    normal = outer.normal[edge][:, None]
    step = outer.points[vertices] - outer.points[outer.vertices[2 * edge]][:, None]
    far = step[..., 1] * normal[..., 0] - step[..., 0] * normal[..., 1]
    return frozen_float(far), frozen_float((step * normal).sum(axis=2))


def _plates(outer: Outer, pairs: Int, reach: Float) -> Contacts:
    """Faces with the same vertices, plane faces in one plane that share an area, tiles of warped faces."""
    row, first, second = _all_vertex_pairs(outer, pairs)
    gap = np.linalg.norm(outer.points[first] - outer.points[second], axis=1)
    near = gap <= reach[row]
    hits = np.bincount(row[near], minlength=len(pairs))
    sizes = np.diff(outer.offsets)[pairs]
    alike = (hits == sizes[:, 0]) & (hits == sizes[:, 1])
    size = outer.measure[pairs]
    ordered = frozen_int(np.where((size[:, 0] < size[:, 1])[:, None], pairs[:, ::-1], pairs))  # large, small
    high, warp = _lifts(outer, ordered, row, first, second)
    flat = high <= reach
    bent = np.flatnonzero(~alike & ~flat & (high <= 1.01 * warp))
    flat[bent] = _on_edges(outer, frozen_int(ordered[bent]), reach[bent]) >= _LAID
    flat &= ~alike
    share = np.repeat(alike[:, None].astype(float), 2, axis=1)
    share[flat] = _shares(outer, frozen_int(pairs[flat]), outer.normal[ordered[flat, 0]])
    slack = np.minimum(_BESIDE[0] * reach / np.sqrt(size.min(axis=1)), _BESIDE[1])
    slack = np.maximum(slack, _OVERLAP)
    over = share.max(axis=1, initial=0) > slack
    distinct = np.bincount(row[near & (first != second)], minlength=len(pairs)) > 0
    return Contacts(
        frozen_int(pairs[over]),
        frozen_float(share[over]),
        frozen_float(slack[over]),
        alike[over],
        distinct[over],
        frozen_int(np.stack((first, second), axis=1)[near & over[row]]),
        frozen_int(np.empty((0, 2))),
        frozen_float([]),
    )


def _lifts(outer: Outer, ordered: Int, row: Int, first: Int, second: Int) -> tuple[Float, Float]:
    """Largest distances of the vertices of both faces, and of the large one, from its mean plane."""
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
    """Count the vertices of the second of two faces that lie on edges of the first."""
    following = np.arange(1, len(outer.vertices) + 1)
    following[outer.offsets[1:] - 1] = outer.offsets[:-1]
    offsets, edge = gather(outer.offsets, frozen_int(ordered[:, 0]))
    row = np.repeat(np.arange(len(ordered)), np.diff(offsets))
    ends, vertex = gather(outer.offsets, frozen_int(ordered[row, 1]))
    times = np.diff(ends)
    row, edge = np.repeat(row, times), np.repeat(edge, times)
    tail, head = (outer.points[outer.vertices[places]] for places in (edge, following[edge]))
    along, step = head - tail, outer.points[outer.vertices[vertex]] - tail
    at = (step * along).sum(axis=1) / np.maximum((along * along).sum(axis=1), np.finfo(float).tiny)
    off = np.linalg.norm(step - np.clip(at, 0, 1)[:, None] * along, axis=1)
    found = np.unique(np.stack((row, vertex))[:, off <= reach[row]], axis=1)[0]
    return frozen_int(np.bincount(found, minlength=len(ordered)))


def _all_vertex_pairs(outer: Outer, pairs: Int) -> tuple[Int, Int, Int]:
    """Each vertex of the first face of a pair with each of the second: pair and the two vertices."""
    offsets, places = gather(outer.offsets, frozen_int(pairs[:, 0]))
    row = np.repeat(np.arange(len(pairs)), np.diff(offsets))
    ends, others = gather(outer.offsets, frozen_int(pairs[row, 1]))
    times = np.diff(ends)
    return (
        frozen_int(np.repeat(row, times)),
        frozen_int(np.repeat(outer.vertices[places], times)),
        frozen_int(outer.vertices[others]),
    )


def _shares(outer: Outer, pairs: Int, normal: Float) -> Float:
    """Shares ``(k, 2)`` of two faces that the other covers, seen along ``normal (k, 3)``."""
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
