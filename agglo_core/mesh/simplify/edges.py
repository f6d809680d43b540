"""Simplify 2-D meshes: remove vertices from the edge chains between two cells.

All cells remain valid polygons.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from agglo_core.arrays import Float, Int, Mask, frozen_int
from agglo_core.mesh.derived import Derived
from agglo_core.mesh.geometry.loops import faces_of_cells
from agglo_core.mesh.simplify.chains import Chains, chains_of, ends_at
from agglo_core.mesh.simplify.record import Fewer, assemble_faces, rounding_of

MAX_TOLERANCE = 0.5
"""Largest tolerance, relative to the cell diameter; beyond it almost no interface keeps a vertex."""

# fractions of the tolerance, tried in turn if cells become invalid; more: fewer faces, slower
# (benchmarks/simplified.py)
_STEPS = (1.0, 0.5, 0.25, 0.125, 0.0)
_LEAST = 0.5  # fraction of its measure that a cell keeps; smaller: fewer faces (benchmarks/simplified.py)


def fewer_edges(mesh: Derived, tags: Mapping[str, Int], tolerance: float) -> Fewer:
    """Remove vertices of a 2-D mesh that are superfluous within ``tolerance`` times the cell diameter.

    Chains end where more than two edges meet and where a tag changes. Chains on the boundary are thinned only
    where they are straight, others within the tolerance times the diameter of the smaller cell.
    """
    # Chains between two cells, thinned exactly, then within the tolerance.
    tails, heads = _directed_edges(mesh)
    joint, at = _joints(mesh, tails, heads, tags)
    chains = chains_of(mesh.local_points, mesh.face_pairs, joint, at)
    limits = np.full(chains.n, rounding_of(mesh))
    keep = np.ones(len(chains.vertices), bool)
    chains.thin(mesh.local_points, limits, frozen_int(np.arange(chains.n)), keep)
    held_back = _thin_within(mesh, chains, tolerance, limits, keep, tails) if tolerance > 0 else 0
    # Number the new edges, with the smallest old edge as their representative.
    faces = np.empty(mesh.n_faces, np.int64)
    faces[chains.edges] = runs = chains.runs(keep)
    lead = np.full(int(runs[-1]) + 1, mesh.n_faces)
    np.minimum.at(lead, runs, chains.edges)
    forward = np.empty(mesh.n_faces, bool)  # True if the chain has the direction of the face
    forward[chains.edges] = mesh.face_pairs[chains.edges, 0] == chains.vertices[chains.before]
    ends = np.stack(_ends(chains, keep), axis=1)
    pairs = np.where(forward[lead][:, None], ends, ends[:, ::-1])
    return assemble_faces(np.full(len(pairs), 2), frozen_int(pairs.ravel()), frozen_int(faces), held_back)


def _directed_edges(mesh: Derived) -> tuple[Int, Int]:
    """Return tails and heads of the edges, with the higher-numbered cell on the left."""
    owner, other = mesh.face_cells.T
    pairs = np.where((owner > other)[:, None], mesh.face_pairs, mesh.face_pairs[:, ::-1])
    return frozen_int(pairs[:, 0]), frozen_int(pairs[:, 1])


def _joints(mesh: Derived, tails: Int, heads: Int, tags: Mapping[str, Int]) -> tuple[Mask, Int]:
    """Find vertices that join exactly two edges with equal tags between the same two cells."""
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
    """Return the first and last vertex per merged edge."""
    begins = np.flatnonzero(keep[chains.before])
    last = np.append(begins[1:], len(chains.edges)) - 1
    return (
        frozen_int(chains.vertices[chains.before[begins]]),
        frozen_int(chains.vertices[chains.before[last] + 1]),
    )


def _thin_within(
    mesh: Derived, chains: Chains, tolerance: float, exact: Float, keep: Mask, tails: Int
) -> int:
    """Thin edge chains within a tolerance that is reduced where cells would become invalid.

    Return the number of chains with a reduced tolerance.
    """
    first = chains.edges[chains.offsets[:-1]]
    cells = mesh.face_cells[first]
    inner = cells[:, 1] >= 0
    h = mesh.cell_diameters
    width = np.where(inner, tolerance * np.minimum(h[cells[:, 0]], h[cells[:, 1]]), 0.0)
    step = np.where(inner, 0, len(_STEPS) - 1)
    changed = np.flatnonzero(inner & (np.diff(chains.offsets) > 1))
    # Reduce the tolerance of the chains of invalid cells until all cells are valid.
    while len(changed):
        limits = np.maximum(width * np.take(_STEPS, step), exact)
        chains.thin(mesh.local_points, limits, frozen_int(changed), keep)
        doubtful = frozen_int(np.setdiff1d(cells[changed], [-1]))
        bad = _chains_of_invalid_cells(mesh, chains, keep, tails, doubtful)
        changed = np.flatnonzero(bad & (step < len(_STEPS) - 1))
        step[changed] += 1
    return int(np.count_nonzero(inner & (step > 0)))


def _chains_of_invalid_cells(mesh: Derived, chains: Chains, keep: Mask, tails: Int, doubtful: Int) -> Mask:
    """Return the mask of edge chains whose thinning makes a cell invalid.

    Invalid cells cross themselves, are inverted, or have less than half their measure.
    """
    from agglo_core.mesh.kernels.cell_crossings import mark_crossings

    # Directed edges of each cell, sorted by their smallest x.
    begin, end = _ends(chains, keep)
    starts = np.flatnonzero(keep[chains.before])
    chain, edge = chains.of_edges[starts], chains.edges[starts]
    sides = np.sort(mesh.face_cells[edge], axis=1)[:, ::-1]  # the larger number is on the left
    forward = tails[edge] == begin
    tail, head = np.where(forward, begin, end), np.where(forward, end, begin)
    offsets, cell_edges = faces_of_cells(frozen_int(sides), mesh.n_cells)
    cell = np.repeat(np.arange(mesh.n_cells), np.diff(offsets))
    points = mesh.local_points
    cell_edges = cell_edges[np.lexsort((np.minimum(points[tail, 0], points[head, 0])[cell_edges], cell))]
    is_left = sides[cell_edges, 0] == cell
    tail, head = (
        np.where(is_left, tail[cell_edges], head[cell_edges]),
        np.where(is_left, head[cell_edges], tail[cell_edges]),
    )
    # Crossings and inversions.
    bad = np.zeros(chains.n, bool)
    of_cells = frozen_int(tail), frozen_int(head), frozen_int(chain[cell_edges])
    mark_crossings(points, offsets, *of_cells, doubtful, bad)
    # Cells that lost too much area.
    middle = mesh.local_centroids[cell]
    a, b = points[tail] - middle, points[head] - middle
    area = 0.5 * np.bincount(cell, a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], mesh.n_cells)
    too_small = area < _LEAST * mesh.cell_measures
    bad[chain[cell_edges[too_small[cell]]]] = True
    return bad
