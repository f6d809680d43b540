"""Simplify 3-D meshes: merge coplanar faces between the same two cells into one polygon."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int, Mask, frozen_float, frozen_int
from agglo_core.mesh.derived import Derived
from agglo_core.mesh.geometry.solid_cells import sum_by
from agglo_core.mesh.simplify.chains import chains_of, ends_at
from agglo_core.mesh.simplify.record import Fewer, assemble_faces, rounding_of

_SLACK = 4.0  # tolerance of planes through rounded points, in units of rounding


class _Loops(NamedTuple):
    """Faces as vertex loops: loop l has ``vertices[offsets[l]:offsets[l + 1]]``.

    ``faces`` maps old faces to loops.
    """

    offsets: Int
    vertices: Int
    faces: Int


def fewer_faces(mesh: Derived, tags: Mapping[str, Int]) -> Fewer:
    """Merge coplanar faces between the same two cells, and then collinear edges.

    Patches with holes and self-touching patches are not merged, because faces are single loops.
    """
    loops = _merge_patches(mesh, tags)
    keep = _bends(mesh, loops)[loops.vertices]
    sizes = np.add.reduceat(keep.astype(np.int64), loops.offsets[:-1])
    return assemble_faces(frozen_int(sizes), frozen_int(loops.vertices[keep]), loops.faces)


def _heads(offsets: Int, vertices: Int) -> Int:
    """Return the next vertex along the loop for each loop vertex."""
    heads = np.roll(vertices, -1)
    heads[offsets[1:] - 1] = vertices[offsets[:-1]]
    return frozen_int(heads)


def _merge_patches(mesh: Derived, tags: Mapping[str, Int]) -> _Loops:
    """Merge each flat patch whose boundary is one simple loop, and keep all other faces."""
    from agglo_core.mesh.kernels.patch_loops import outlines

    # Group the faces into patches; edges between faces of a patch are inner.
    face = np.repeat(np.arange(mesh.n_faces), np.diff(mesh.face_offsets))
    tails, heads = mesh.face_vertices, _heads(mesh.face_offsets, mesh.face_vertices)
    a, b = _twins(tails, heads, mesh.n_points)
    patch = _patches(mesh, tags, face[a], face[b], tails[a] == tails[b])
    inner = np.zeros(len(face), bool)
    within = patch[face[a]] == patch[face[b]]
    inner[a[within]] = inner[b[within]] = True
    lead = np.unique(patch, return_index=True)[1]  # first face of each patch
    turned = (mesh.face_cells[:, 0] != mesh.face_cells[lead[patch], 0])[face]
    tails, heads = np.where(turned, heads, tails), np.where(turned, tails, heads)
    # Boundary edges of patches with several faces, oriented like the first face.
    several = np.bincount(patch)[patch[face]] > 1
    outer = np.flatnonzero(several & ~inner)
    outer = outer[np.argsort(patch[face[outer]], kind="stable")]
    counts = np.bincount(patch[face[outer]], minlength=len(lead))
    around = frozen_int(np.concatenate(([0], np.cumsum(counts))))
    of_edges = frozen_int(tails[outer]), frozen_int(heads[outer])
    outline, whole = outlines(around, *of_edges, mesh.n_points)
    return _join_outlines(mesh, frozen_int(patch), around, outline, whole)


def _twins(tails: Int, heads: Int, n_points: int) -> tuple[Int, Int]:
    """Return the pairs of half-edges at edges with exactly two faces."""
    key = np.minimum(tails, heads) * n_points + np.maximum(tails, heads)
    order = np.argsort(key, kind="stable")
    start = np.flatnonzero(np.append(True, np.diff(key[order]) != 0))
    pairs = start[np.diff(np.append(start, len(order))) == 2]
    return frozen_int(order[pairs]), frozen_int(order[pairs + 1])


def _join_outlines(mesh: Derived, patch: Int, around: Int, outline: Int, whole: Mask) -> _Loops:
    """Concatenate the boundary loops of merged patches and all other face loops."""
    alone = np.flatnonzero(~whole[patch])
    sizes = np.diff(mesh.face_offsets)
    is_alone = np.zeros(mesh.n_faces, bool)
    is_alone[alone] = True
    merged = np.flatnonzero(whole)
    in_outline = np.repeat(whole, np.diff(around))
    lengths = np.concatenate((np.diff(around)[merged], sizes[alone]))
    vertices = np.concatenate((outline[in_outline], mesh.face_vertices[np.repeat(is_alone, sizes)]))
    number = np.empty(len(whole), np.int64)
    number[merged] = np.arange(len(merged))
    faces = number[patch]
    faces[alone] = len(merged) + np.arange(len(alone))
    offsets = np.concatenate(([0], np.cumsum(lengths)))
    return _Loops(frozen_int(offsets), frozen_int(vertices), frozen_int(faces))


def _patches(mesh: Derived, tags: Mapping[str, Int], f: Int, g: Int, ways: Mask) -> Int:
    """Return the index of the flat patch (set of coplanar faces) that contains each face.

    Faces f and g share an edge, traversed in the same direction if ``ways``.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    # Candidates: equal cells, consistent orientation, equal tags.
    cells = np.sort(mesh.face_cells, axis=1)
    is_candidate = (f != g) & (cells[f] == cells[g]).all(axis=1)
    is_candidate &= ways == (mesh.face_cells[f, 0] != mesh.face_cells[g, 0])
    for values in tags.values():
        is_candidate &= values[f] == values[g]
    f, g = f[is_candidate], g[is_candidate]
    # Both faces must lie in the plane of the larger face.
    large = mesh.face_measures[f] >= mesh.face_measures[g]
    f, g = np.where(large, f, g), np.where(large, g, f)
    slack = _SLACK * rounding_of(mesh)
    vector, centre = mesh.face_normals, _centres(mesh)
    same_owner = mesh.face_cells[f, 0] == mesh.face_cells[g, 0]
    facing = (vector[f] * vector[g]).sum(axis=1) * np.where(same_owner, 1.0, -1.0) > 0.5
    flat = facing & (_distances_from_planes(mesh, g, vector[f], centre[f]) <= slack)
    flat &= _distances_from_planes(mesh, f, vector[f], centre[f]) <= slack
    f, g = f[flat], g[flat]
    links = coo_array((np.ones(len(f)), (f, g)), shape=(mesh.n_faces, mesh.n_faces))
    patch = connected_components(links, directed=False)[1].astype(np.int64)
    return _split_bent_patches(mesh, frozen_int(patch), slack)


def _split_bent_patches(mesh: Derived, patch: Int, slack: float) -> Int:
    """Split patches that bend gradually, and so are not flat, into single faces.

    Return all patches.
    """
    # Mean plane of each patch.
    lead = np.unique(patch, return_index=True)[1][patch]
    sign = np.where(mesh.face_cells[:, 0] == mesh.face_cells[lead, 0], 1.0, -1.0)[:, None]
    weight, n = mesh.face_measures, int(patch.max(initial=-1)) + 1
    total = sum_by(patch, sign * mesh.face_normals * weight[:, None], n)
    area = np.bincount(patch, weight, n)[:, None]
    safe = np.where(area > 0, area, 1.0)
    normal, centre = total / safe, sum_by(patch, _centres(mesh) * weight[:, None], n) / safe
    # Split patches with a vertex off this plane.
    every = np.arange(mesh.n_faces)
    off = _distances_from_planes(mesh, every, normal[patch], centre[patch])
    wrong = np.zeros(n, bool)
    wrong[patch[off > slack]] = True
    wrong &= np.bincount(patch, minlength=n) > 1
    return frozen_int(np.unique(np.where(wrong[patch], n + every, patch), return_inverse=True)[1])


def _centres(mesh: Derived) -> Float:
    """Return the mean ``(n_faces, 3)`` of each face's vertices."""
    sizes = np.diff(mesh.face_offsets)
    face = frozen_int(np.repeat(np.arange(mesh.n_faces), sizes))
    return frozen_float(sum_by(face, mesh.local_points[mesh.face_vertices], mesh.n_faces) / sizes[:, None])


def _distances_from_planes(mesh: Derived, faces: Int, normals: Float, centres: Float) -> Float:
    """Return the largest distance of each face's vertices from a plane, given by normal and centre."""
    sizes = np.diff(mesh.face_offsets)[faces]
    row = np.repeat(np.arange(len(faces)), sizes)
    start = np.cumsum(sizes) - sizes
    places = np.arange(len(row)) + np.repeat(mesh.face_offsets[faces] - start, sizes)
    arm = mesh.local_points[mesh.face_vertices[places]] - centres[row]
    off = np.abs((arm * normals[row]).sum(axis=1))
    return frozen_float(np.maximum.reduceat(off, start) if len(faces) else off)


def _bends(mesh: Derived, loops: _Loops) -> Mask:
    """Return the mask of corners: points that are not in the interior of a straight chain of edges."""
    heads = _heads(loops.offsets, loops.vertices)
    ends = np.sort(np.stack((loops.vertices, heads), axis=1), axis=1)
    ends = np.unique(ends, axis=0)
    joint, at = ends_at(frozen_int(ends), mesh.n_points)
    chains = chains_of(mesh.local_points, frozen_int(ends), joint, at)
    keep = np.ones(len(chains.vertices), bool)
    limits = np.full(chains.n, rounding_of(mesh))
    chains.thin(mesh.local_points, frozen_float(limits), frozen_int(np.arange(chains.n)), keep)
    corner = np.ones(mesh.n_points, bool)
    corner[chains.vertices[~keep]] = False
    return corner
