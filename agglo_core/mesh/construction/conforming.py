"""Join coincident outer (boundary) faces of cells: insert hanging vertices and merge points."""

from __future__ import annotations

import logging
from typing import NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int, Mask, frozen_float, frozen_int
from agglo_core.errors import MeshError
from agglo_core.mesh.checks import last_place
from agglo_core.mesh.construction.touching import Contacts, Outer, facing_pairs, find_contacts, outer_faces
from agglo_core.mesh.derived import Derived
from agglo_core.mesh.elements import gather

_log = logging.getLogger("agglo")

TOLERANCE = 1e-6  # relative to the cells: above rounding, below intended gaps
_NEAR = 1e-2  # tolerance up to which unjoined faces cause a warning
_ROUNDING = 8  # rounding of points, in units in the last place of the largest coordinate

# name of the repair, by dimension
_CUT = {2: "hanging vertices inserted", 3: "faces split like those of neighbours"}
_WAYS_OUT = "merge_points=True joins faces whose points are duplicates; allow_gaps=True accepts the gap"
_NARROW = f"mesh.conforming(tolerance={_NEAR:g}) joins them; allow_gaps=True accepts the gap"


class Joined(NamedTuple):
    """Arrays of a :class:`~agglo_core.mesh.Mesh` whose coincident outer faces have been joined."""

    points: Float
    face_offsets: Int
    face_vertices: Int
    face_cells: Int
    sources: Int  # (2, n_faces) faces of the given mesh behind each face, often the same face twice
    repairs: dict[str, int]


class _Pieces(NamedTuple):
    """Pieces of outer faces: edges cut at hanging vertices, or polygons tiled by smaller ones."""

    face: Int  # face number in Outer
    # CSR of the pieces; vertices are numbered as in Outer
    offsets: Int
    vertices: Int  # numbers in Outer
    partner: Int  # piece on the other side, or −1


def join_outer_faces(mesh: Derived, tolerance: float, merge: bool) -> Joined | None:
    """Join coincident outer faces into interior faces, so that their cells become neighbours.

    Return None if there are none.

    Parameters
    ----------
    mesh : Mesh
    tolerance : float
        Relative to length and height of the smaller face's cell.
    merge : bool
        Merge coincident points.

    Raises
    ------
    MeshError
        For 3-D faces that overlap partially.
    """
    # Find the contacts, cut the faces and pair the pieces.
    outer, contacts = _contacts(mesh, tolerance)
    if not len(contacts.pairs):
        return None
    owner = frozen_int(mesh.face_cells[outer.faces, 0])
    place = _places(len(outer.used), contacts.same)
    pieces = (
        _cut_edges(outer, contacts, place, owner, merge)
        if mesh.dim == 2
        else _split_tiled_faces(outer, contacts, merge)
    )
    # Report contacts without a joined piece.
    inner = np.flatnonzero(pieces.partner >= 0)
    joined_pairs = np.stack((pieces.face[inner], pieces.face[pieces.partner[inner]]), axis=1)
    is_unjoined = ~_mark_common_pairs(contacts.pairs, joined_pairs, len(outer.faces))
    if mesh.dim == 2:  # edges shorter than the tolerance have become points
        ends = place[outer.vertices].reshape(-1, 2)
        is_unjoined &= (ends[:, 0] != ends[:, 1])[contacts.pairs].all(axis=1)
    if is_unjoined.any():
        detail = _describe_pairs(owner[contacts.pairs[is_unjoined]])
        if mesh.dim == 3 and not contacts.alike[is_unjoined].all():
            raise MeshError(
                f"{detail} only partially, so the cells would not be neighbours. Give both sides the same "
                "faces and points, or one side faces that tile those of the other; or pass "
                "allow_gaps=True if the gap is intended (a fracture, bodies in contact)"
            )
        _log.warning("%s but were not joined: the domain has a gap there. %s", detail, _WAYS_OUT)
    return _build_mesh(mesh, outer, pieces, place, int(is_unjoined.sum()))


def warn_of_gaps(mesh: Derived) -> None:
    """Log a warning if a mesh has coincident outer faces, which leave a gap in the domain."""
    outer, contacts = _contacts(mesh, TOLERANCE)
    if len(contacts.pairs):
        found = _describe_pairs(mesh.face_cells[outer.faces[contacts.pairs], 0])
        _log.warning("%s: the domain has a gap there. mesh.conforming() joins them", found)


def _contacts(mesh: Derived, tolerance: float) -> tuple[Outer, Contacts]:
    """Return the outer faces and their coincident pairs, and warn of nearly coincident pairs."""
    outer = outer_faces(mesh)
    pairs = facing_pairs(outer)
    owner = mesh.face_cells[outer.faces, 0]
    pairs = frozen_int(pairs[owner[pairs[:, 0]] != owner[pairs[:, 1]]])
    contacts = find_contacts(outer, pairs, reach(mesh, outer, pairs, tolerance))
    if len(pairs) and tolerance < _NEAR:
        near = find_contacts(outer, pairs, reach(mesh, outer, pairs, _NEAR)).pairs
        near = near[~_mark_common_pairs(near, contacts.pairs, len(owner))]
        if len(near):
            _log.warning(
                "%s only approximately: the domain has a gap there. %s", _describe_pairs(owner[near]), _NARROW
            )
    return outer, contacts


def _describe_pairs(cells: Int) -> str:
    """Return a message that the cell pairs ``(k, 2)`` have coincident outer faces."""
    first, second = np.sort(cells[0]).tolist()
    return f"{len(cells)} pairs of outer faces, such as of cells {first} and {second}, coincide"


def reach(mesh: Derived, outer: Outer, pairs: Int, tolerance: float) -> Float:
    """Return for each face pair the distance up to which its faces count as coincident."""
    if not len(pairs):
        return frozen_float([])
    size = outer.measure if mesh.dim == 2 else np.sqrt(outer.measure)
    area = np.where(outer.measure > 0, outer.measure, 1.0)  # faces without area occur in no pair
    height = mesh.cell_measures[mesh.face_cells[outer.faces, 0]] / area
    small = np.minimum(size, height)[pairs].min(axis=1)
    rounding = _ROUNDING * last_place(mesh.points[outer.used])
    return frozen_float(np.minimum(np.maximum(tolerance * small, rounding), 0.01 * small))


def _places(n: int, pairs: Int) -> Int:
    """Return for each of n points the smallest index among the points that coincide with it."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    links = coo_array((np.ones(len(pairs)), pairs.T), shape=(n, n))
    group = connected_components(links, directed=False)[1]
    return frozen_int(np.unique(group, return_index=True)[1][group])


def _cut_edges(outer: Outer, contacts: Contacts, place: Int, owner: Int, merge: bool) -> _Pieces:
    """Cut outer edges at the hanging vertices inside them, and pair opposite pieces."""
    ends = outer.vertices.reshape(-1, 2)
    # Keep each cut point once per edge, in order along the edge.
    edge, point = contacts.inside.T
    new = (place[point][:, None] != place[ends[edge]]).all(axis=1)
    edge, point, along = edge[new], point[new], contacts.along[new]
    first = np.unique(np.stack((edge, place[point])), axis=1, return_index=True)[1]
    first = first[np.lexsort((along[first], edge[first]))]
    edge, point = edge[first], point[first]
    # Split the edges at these points.
    count = np.bincount(edge, minlength=len(ends)) + 1
    face = frozen_int(np.repeat(np.arange(len(ends)), count))
    tails = np.insert(ends[:, 0], edge + 1, point)
    heads = np.insert(ends[:, 1], edge, point)
    # Join pieces; without merging only those with identical points.
    partner = _opposite_pieces(place[tails], place[heads], owner[face])
    if not merge:
        own = partner < 0
        match = (tails == heads[partner]) & (heads == tails[partner])
        partner = np.where(own | ~match, -1, partner)
    vertices = np.stack((tails, heads), axis=1).ravel()
    return _Pieces(
        face,
        frozen_int(np.arange(0, len(vertices) + 1, 2)),
        frozen_int(vertices),
        frozen_int(partner),
    )


def _opposite_pieces(tails: Int, heads: Int, owner: Int) -> Int:
    """Return for each edge piece its only counterpart with reversed direction, or −1 without one."""
    order = np.lexsort((np.maximum(tails, heads), np.minimum(tails, heads)))
    ends = np.sort(np.stack((tails, heads))[:, order], axis=0)
    start = np.flatnonzero(np.concatenate(([True], (np.diff(ends, axis=1) != 0).any(axis=0))))
    two = start[np.diff(np.append(start, len(order))) == 2]
    a, b = order[two], order[two + 1]
    fits = (tails[a] == heads[b]) & (tails[a] != heads[a]) & (owner[a] != owner[b])
    partner = np.full(len(tails), -1)
    partner[a[fits]], partner[b[fits]] = b[fits], a[fits]
    return frozen_int(partner)


def _split_tiled_faces(outer: Outer, contacts: Contacts, merge: bool) -> _Pieces:
    """Pair outer faces with equal vertices, and split each face that smaller faces tile."""
    n = len(outer.faces)
    fits = merge | ~contacts.distinct
    times = np.bincount(contacts.pairs.ravel(), minlength=n)
    # Each tiled face is replaced by the mirrored loops of its tiles.
    large, small = _tiles(outer, contacts, fits, times)
    whole = np.setdiff1d(np.arange(n), large)
    face, loop = np.concatenate((whole, large)), np.concatenate((whole, small))
    order = np.argsort(face, kind="stable")
    piece = np.empty(len(face), np.int64)
    piece[order] = np.arange(len(face))
    # Pair identical faces, and each tile with its copy.
    twins = contacts.pairs[fits & contacts.alike & (times[contacts.pairs] == 1).all(axis=1)]
    piece_of = np.full(n, -1)
    piece_of[whole] = piece[: len(whole)]
    partner = np.full(len(face), -1)
    for a, b in ((piece_of[twins[:, 0]], piece_of[twins[:, 1]]), (piece[len(whole) :], piece_of[small])):
        partner[a], partner[b] = b, a
    offsets, places = gather(outer.offsets, frozen_int(loop[order]))
    mirrored = np.repeat(offsets[:-1] + offsets[1:] - 1, np.diff(offsets)) - np.arange(len(places))
    turned = np.repeat(face[order] != loop[order], np.diff(offsets))  # seen from the other side
    vertices = outer.vertices[np.where(turned, places[mirrored], places)]
    return _Pieces(frozen_int(face[order]), offsets, frozen_int(vertices), frozen_int(partner))


def _tiles(outer: Outer, contacts: Contacts, fits: Mask, times: Int) -> tuple[Int, Int]:
    """Return pairs (face, tile) for each face that smaller faces, its tiles, cover completely.

    Tiles are in contact with this face only.
    """
    ordered_pairs = np.concatenate((contacts.pairs, contacts.pairs[:, ::-1]))
    share, slack = np.concatenate((contacts.share, contacts.share[:, ::-1])), np.tile(contacts.slack, 2)
    tile = (share[:, 1] > 1 - slack) & np.tile(fits & ~contacts.alike, 2) & (times[ordered_pairs[:, 1]] == 1)
    large, small = ordered_pairs[tile].T
    n = len(times)
    # A face is tiled if the shares of its contacts sum to 1 within their tolerance.
    cover = np.bincount(large, weights=share[tile, 0], minlength=n)
    tolerance = np.bincount(large, weights=(slack * share[:, 0])[tile], minlength=n)
    full = (np.abs(cover - 1) <= 2 * tolerance) & (np.bincount(large, minlength=n) == times)
    return frozen_int(large[full[large]]), frozen_int(small[full[large]])


def _build_mesh(mesh: Derived, outer: Outer, pieces: _Pieces, place: Int, n_unjoined: int) -> Joined:
    """Build the mesh in which joined outer faces are replaced by their pieces."""
    inner = pieces.partner >= 0
    split = np.zeros(len(outer.faces), bool)
    split[pieces.face[inner]] = True
    # Keep the other faces, and one piece of each joined pair.
    untouched = np.ones(len(mesh.face_cells), bool)
    untouched[outer.faces[split]] = False
    old = np.flatnonzero(untouched)
    number = np.arange(len(pieces.face))
    new = np.flatnonzero(split[pieces.face] & ~(inner & (pieces.partner < number)))
    partner_face = pieces.face[np.where(inner, pieces.partner, number)]
    sources = outer.faces[np.stack((pieces.face, partner_face), axis=1)[new]]
    cells = mesh.face_cells[sources, 0]
    cells[~inner[new], 1] = -1
    # Sort by original face number and renumber the points.
    order = np.argsort(np.concatenate((old, sources[:, 0])), kind="stable")
    piece_counts = np.bincount(pieces.face)[split]
    point, remaining_points = _merge_points(mesh.n_points, outer, pieces, place)
    (a, at_old), (b, at_new) = (
        gather(mesh.face_offsets, frozen_int(old)),
        gather(pieces.offsets, frozen_int(new)),
    )
    vertices = point[np.concatenate((mesh.face_vertices[at_old], outer.used[pieces.vertices[at_new]]))]
    if mesh.dim == 2:  # an edge shorter than the tolerance may have become a point
        order = order[(vertices[::2] != vertices[1::2])[order]]
    offsets, places = gather(frozen_int(np.append(a, b[1:] + a[-1])), frozen_int(order))
    return Joined(
        frozen_float(mesh.points[remaining_points]),
        offsets,
        frozen_int(vertices[places]),
        frozen_int(np.concatenate((mesh.face_cells[old], cells))[order]),
        frozen_int(np.concatenate((np.stack((old, old), axis=1), sources))[order].T),
        {
            _CUT[mesh.dim]: int((piece_counts - 1).sum() if mesh.dim == 2 else (piece_counts > 1).sum()),
            "points of outer faces merged": mesh.n_points - len(remaining_points),
            "outer faces on one another left apart": n_unjoined,
        },
    )


def _merge_points(n: int, outer: Outer, pieces: _Pieces, place: Int) -> tuple[Int, Int]:
    """Merge coincident points of joined pieces of faces.

    Return new numbers for all n points, and the kept points.
    """
    ends = np.zeros(len(place), bool)
    joined = gather(pieces.offsets, frozen_int(np.flatnonzero(pieces.partner >= 0)))[1]
    ends[place[pieces.vertices[joined]]] = True
    target = np.arange(n)
    target[outer.used] = outer.used[np.where(ends[place], place, np.arange(len(place)))]
    remaining_points = np.flatnonzero(target == np.arange(n))
    number = np.empty(n, np.int64)
    number[remaining_points] = np.arange(len(remaining_points))
    return frozen_int(number[target]), frozen_int(remaining_points)


def _mark_common_pairs(pairs: Int, others: Int, n: int) -> Mask:
    """Mark the index pairs (indices below n) that also occur among the others, in either order."""
    key, known = (np.sort(each, axis=1) @ [n, 1] for each in (pairs, others))
    return np.isin(key, known)
