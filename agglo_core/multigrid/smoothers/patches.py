"""Patches (sets of jointly solved parts): around vertices, or from pairs of coupled parts."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float, Index, Int, frozen_index, frozen_int
from agglo_core.errors import OptionError
from agglo_core.mesh import Mesh
from agglo_core.multigrid.kernels.patch_search import parts_at_vertices, unite_pairs, without_contained
from agglo_core.problems import Patches

_SHORT = 0.4
"""Maximum length of a short edge, relative to the diameter of an adjacent cell.

Larger: fewer but larger patches (benchmarks/solve.py).
"""
_JOINED = 3  # maximum number of vertices joined along short edges; more: larger patches (benchmarks/solve.py)
_SHORT_ALONG = 0.7
"""With tensors: maximum length of a short edge, relative to the longest edge of an adjacent cell
(benchmarks/elliptic.py --rows ε)."""
_JOINED_ALONG = 8
"""With tensors: maximum number of vertices joined (benchmarks/elliptic.py --rows ε)."""
MAX_PARTS = 64
"""Default maximum number of parts per vertex patch. Memory and time of a patch grow faster than this number
(benchmarks/solve.py --meshes slivers)."""


def vertex_patches(
    mesh: Mesh, labels: Int | None = None, *, most: int = MAX_PARTS, tensors: Float | None = None
) -> Patches:
    """Return the patches of mesh cells, or of agglomerates, around their common vertices.

    A patch inside another is dropped. A part without neighbours forms a separate patch. Patches are in
    lexicographic order, so that sweeps follow the numbering of the parts.

    Parameters
    ----------
    mesh : Mesh
        2-D or 3-D mesh.
    labels : (n_cells,) int, optional
        Part per cell, 0..k−1. By default, the cells are the parts. Then up to three vertices joined
        by edges shorter than 0.4 times the diameter of an adjacent cell count as one: their patches would
        hardly differ, and needles are smoothed together with all cells around.
    most : int
        Maximum number of parts around a vertex with patch, to keep the dense matrices small.
    tensors : (n_cells, d, d) float, optional
        Coefficient K of a diffusion problem per cell. The length of an edge e is then (e·K⁻¹e)^½, and up to
        eight vertices are joined by edges shorter than 0.7 times the longest edge of an adjacent cell: the
        patches extend along the strong direction.

    Raises
    ------
    MeshError
        If the labels have a wrong shape, or leave gaps.

    Examples
    --------
    >>> from agglo_core import samples
    >>> patches = vertex_patches(samples.squares(3))
    >>> patches.parts.reshape(-1, 4).tolist()
    [[0, 1, 3, 4], [1, 2, 4, 5], [3, 4, 6, 7], [4, 5, 7, 8]]
    """
    if labels is None:
        parts, n_parts = frozen_int(np.arange(mesh.n_cells)), mesh.n_cells
        groups, n_groups = _join_short_edges(mesh, most, tensors)
    else:
        parts = mesh.check_labels(labels)
        n_parts = int(parts.max(initial=-1)) + 1
        groups, n_groups = frozen_index(np.arange(mesh.n_points)), mesh.n_points
    offsets, members = parts_at_vertices(*mesh.cell_vertices, groups, parts, n_groups, n_parts, most)
    offsets, members = without_contained(frozen_int(offsets), frozen_index(members), n_parts)
    return Patches(frozen_int(offsets), frozen_int(members))


def _join_short_edges(mesh: Mesh, most: int, tensors: Float | None) -> tuple[Index, int]:
    """Join points along short edges, and return the group per point ``(n_points,)`` and their number.

    The shortest edges are first. Points of too many cells are not joined, as the cells around joined points
    might exceed ``most``.
    """
    ends, faces = _edges(mesh)
    edges = mesh.local_points[ends[:, 1]] - mesh.local_points[ends[:, 0]]
    owner, neighbour = mesh.face_cells[faces].T
    cells = owner, np.where(neighbour < 0, owner, neighbour)
    if tensors is None:
        shortest, joined = _SHORT, _JOINED
        diameters = mesh.cell_diameters
        ratio = np.linalg.norm(edges, axis=1) / np.maximum(diameters[cells[0]], diameters[cells[1]])
    else:
        shortest, joined = _SHORT_ALONG, _JOINED_ALONG
        inverses, longest = np.linalg.inv(tensors), np.zeros(mesh.n_cells)
        lengths = [np.sqrt(np.einsum("ki,kij,kj->k", edges, inverses[side], edges)) for side in cells]
        for side, length in zip(cells, lengths, strict=True):
            np.maximum.at(longest, side, length)
        ratio = np.maximum(*(length / longest[side] for side, length in zip(cells, lengths, strict=True)))
    many = np.bincount(mesh.cell_vertices[1], minlength=mesh.n_points) > most // joined
    short = np.flatnonzero((ratio < shortest) & ~many[ends].any(axis=1))
    short = short[np.argsort(ratio[short], kind="stable")]
    patches = joined_patches(ends[short], mesh.n_points, most=joined)
    groups = np.empty(mesh.n_points, np.int32)
    groups[patches.parts] = np.repeat(np.arange(len(patches)), np.diff(patches.offsets))
    return frozen_index(groups), len(patches)


def _edges(mesh: Mesh) -> tuple[Int, Int]:
    """Return end points ``(m, 2)`` and face of each face edge, with shared edges repeated in 3-D."""
    if mesh.dim == 2:
        return mesh.face_pairs, frozen_int(np.arange(mesh.n_faces))
    following = np.arange(1, len(mesh.face_vertices) + 1)
    following[mesh.face_offsets[1:] - 1] = mesh.face_offsets[:-1]
    ends = np.stack((mesh.face_vertices, mesh.face_vertices[following]), axis=1)
    return frozen_int(ends), frozen_int(np.repeat(np.arange(mesh.n_faces), np.diff(mesh.face_offsets)))


def joined_patches(pairs: Int, n_parts: int, *, most: int = 8) -> Patches:
    """Join parts into groups of at most ``most`` parts by uniting given pairs in order.

    Given the pairs of strongly coupled parts, strongest first, block Gauss–Seidel over the groups replaces
    vertex patches on meshes with flat cells (lines through boundary layers, bundles of slivers). The cost is
    little above Gauss–Seidel over single parts, as each part belongs to one group.

    Parameters
    ----------
    pairs : (m, 2) int
    n_parts : int
    most : int

    Returns
    -------
    Patches
        Groups by ascending smallest part. A part in no pair forms a separate group.

    Raises
    ------
    OptionError
        For a number outside 0..``n_parts`` − 1 in a pair.

    Examples
    --------
    >>> import numpy as np
    >>> groups = joined_patches(np.array([[3, 4], [0, 1], [1, 3]]), 5, most=3)
    >>> [groups.parts[a:b].tolist() for a, b in zip(groups.offsets, groups.offsets[1:])]
    [[0, 1], [2], [3, 4]]
    """
    pairs = frozen_int(pairs)
    if pairs.size and (pairs.min() < 0 or pairs.max() >= n_parts):
        raise OptionError(
            f"pairs contain parts {pairs.min()} to {pairs.max()}, but there are only parts 0 to {n_parts - 1}"
        )
    offsets, parts = unite_pairs(pairs, n_parts, most)
    return Patches(frozen_int(offsets), frozen_int(parts))
