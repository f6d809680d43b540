"""Plane meshes with fewer edges: chains between two cells thinned, as far as all cells stay polygons."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from agglo_core.arrays import Float, Int, Mask, frozen_int
from agglo_core.mesh.derived import Derived
from agglo_core.mesh.geometry.loops import faces_of_cells
from agglo_core.mesh.simplify.chains import Chains, chains_of, ends_at
from agglo_core.mesh.simplify.record import Fewer, packed, rounding_of

MAX_TOLERANCE = 0.5
"""Largest tolerance, over the diameter of a cell: beyond it next to no interface keeps a vertex."""

_STEPS = (1.0, 0.5, 0.25, 0.125, 0.0)  # of the tolerance, one after the other where cells become invalid
_LEAST = 0.5  # of its measure: what a cell keeps


def fewer_edges(mesh: Derived, tags: Mapping[str, Int], tolerance: float) -> Fewer:
    """Edges of a plane mesh with those vertices left out that are not needed within ``tolerance`` of h.

    Chains end where more than two edges meet and where a tag changes; those on the boundary are thinned only
    where they are straight, all others within the tolerance times the diameter of the smaller cell.
    """
    tails, heads = _directed(mesh)
    joint, at = _joints(mesh, tails, heads, tags)
    chains = chains_of(mesh.local_points, mesh.face_pairs, joint, at)
    limits = np.full(chains.n, rounding_of(mesh))
    keep = np.ones(len(chains.vertices), bool)
    chains.thin(mesh.local_points, limits, frozen_int(np.arange(chains.n)), keep)
    held_back = _thin_within(mesh, chains, tolerance, limits, keep, tails) if tolerance > 0 else 0
    faces = np.empty(mesh.n_faces, np.int64)
    faces[chains.edges] = runs = chains.runs(keep)
    lead = np.full(int(runs[-1]) + 1, mesh.n_faces)
    np.minimum.at(lead, runs, chains.edges)
    forward = np.empty(mesh.n_faces, bool)  # whether the chain runs as the face does
    forward[chains.edges] = mesh.face_pairs[chains.edges, 0] == chains.vertices[chains.before]
    ends = np.stack(_ends(chains, keep), axis=1)
    pairs = np.where(forward[lead][:, None], ends, ends[:, ::-1])
    return packed(np.full(len(pairs), 2), frozen_int(pairs.ravel()), frozen_int(faces), held_back)


def _directed(mesh: Derived) -> tuple[Int, Int]:
    """Tail and head of each edge such that the cell of the larger number is on its left."""
    owner, other = mesh.face_cells.T
    pairs = np.where((owner > other)[:, None], mesh.face_pairs, mesh.face_pairs[:, ::-1])
    return frozen_int(pairs[:, 0]), frozen_int(pairs[:, 1])


def _joints(mesh: Derived, tails: Int, heads: Int, tags: Mapping[str, Int]) -> tuple[Mask, Int]:
    """Vertices at which just two edges meet that have the same cells on the same sides, and equal tags."""
    joint, at = ends_at(mesh.face_pairs, mesh.n_points)
    points = np.flatnonzero(joint)
    first, second = at[points].T
    cells = np.sort(mesh.face_cells, axis=1)
    alike = (cells[first] == cells[second]).all(axis=1)
    alike &= (heads[first] == points) != (heads[second] == points)
    for values in tags.values():
        alike &= values[first] == values[second]
    joint[points[~alike]] = False
    return joint, at


def _ends(chains: Chains, keep: Mask) -> tuple[Int, Int]:
    """First and last vertex of each run of edges that became one."""
    begins = np.flatnonzero(keep[chains.before])
    last = np.append(begins[1:], len(chains.edges)) - 1
    return (
        frozen_int(chains.vertices[chains.before[begins]]),
        frozen_int(chains.vertices[chains.before[last] + 1]),
    )


def _thin_within(
    mesh: Derived, chains: Chains, tolerance: float, exact: Float, keep: Mask, tails: Int
) -> int:
    """Thin chains between two cells within a tolerance; returns how many needed a smaller one."""
    first = chains.edges[chains.offsets[:-1]]
    cells = mesh.face_cells[first]
    inner = cells[:, 1] >= 0
    h = mesh.cell_diameters
    width = np.where(inner, tolerance * np.minimum(h[cells[:, 0]], h[cells[:, 1]]), 0.0)
    step = np.where(inner, 0, len(_STEPS) - 1)
    changed = np.flatnonzero(inner & (np.diff(chains.offsets) > 1))
    while len(changed):
        limits = np.maximum(width * np.take(_STEPS, step), exact)
        chains.thin(mesh.local_points, limits, frozen_int(changed), keep)
        doubtful = frozen_int(np.setdiff1d(cells[changed], [-1]))
        bad = _in_bad_cells(mesh, chains, keep, tails, doubtful)
        changed = np.flatnonzero(bad & (step < len(_STEPS) - 1))
        step[changed] += 1
    return int(np.count_nonzero(inner & (step > 0)))


def _in_bad_cells(mesh: Derived, chains: Chains, keep: Mask, tails: Int, doubtful: Int) -> Mask:
    """Mask of the chains that make a cell cross itself, invert or lose more than half its measure."""
    from agglo_core.mesh.kernels.cell_crossings import mark_crossings

    begin, end = _ends(chains, keep)
    starts = np.flatnonzero(keep[chains.before])
    chain, edge = chains.of_edges[starts], chains.edges[starts]
    sides = np.sort(mesh.face_cells[edge], axis=1)[:, ::-1]  # the larger number is on the left
    forward = tails[edge] == begin
    tail, head = np.where(forward, begin, end), np.where(forward, end, begin)
    offsets, own = faces_of_cells(frozen_int(sides), mesh.n_cells)
    cell = np.repeat(np.arange(mesh.n_cells), np.diff(offsets))
    points = mesh.local_points
    own = own[np.lexsort((np.minimum(points[tail, 0], points[head, 0])[own], cell))]
    left = sides[own, 0] == cell
    tail, head = np.where(left, tail[own], head[own]), np.where(left, head[own], tail[own])
    bad = np.zeros(chains.n, bool)
    of_cells = frozen_int(tail), frozen_int(head), frozen_int(chain[own])
    mark_crossings(points, offsets, *of_cells, doubtful, bad)
    middle = mesh.local_centroids[cell]
    a, b = points[tail] - middle, points[head] - middle
    area = 0.5 * np.bincount(cell, a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], mesh.n_cells)
    lost = area < _LEAST * mesh.cell_measures
    bad[chain[own[lost[cell]]]] = True
    return bad
