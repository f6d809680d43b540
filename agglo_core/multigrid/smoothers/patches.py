"""Patches, sets of parts whose unknowns are solved for together: around vertices, or joined by faces."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Index, Int, frozen_index, frozen_int
from agglo_core.errors import OptionError
from agglo_core.mesh import Mesh
from agglo_core.multigrid.kernels.patch_search import parts_at_vertices, united, without_contained
from agglo_core.problems import Patches

_SHORT = 0.4
"""An edge is short below this part of the diameter of a cell beside it."""
_JOINED = 3
_MOST = 64


def vertex_patches(mesh: Mesh, labels: Int | None = None, *, most: int = _MOST) -> Patches:
    """Patches of the cells of a mesh, or of its agglomerates, around the vertices where they meet.

    A patch that lies in another is dropped; a part that meets no other is a patch of its own. Patches
    ascend, compared part by part: a sweep through them runs through the mesh as its parts are numbered.

    Parameters
    ----------
    mesh : Mesh
        In 2-D or 3-D.
    labels : (n_cells,) int, optional
        Part of each cell, 0..k−1. By default the cells are the parts; then up to three vertices joined by
        edges shorter than 0.4 of the diameter of a cell beside count as one: the patches around each would
        hardly differ, and needles are smoothed together with all cells around them.
    most : int
        A vertex where more parts meet has no patch, so that the dense matrices of patches stay small.

    Raises
    ------
    MeshError
        If the labels have another shape, or leave gaps.

    Examples
    --------
    >>> from agglo_core import samples
    >>> patches = vertex_patches(samples.squares(3))
    >>> patches.parts.reshape(-1, 4).tolist()
    [[0, 1, 3, 4], [1, 2, 4, 5], [3, 4, 6, 7], [4, 5, 7, 8]]
    """
    if labels is None:
        parts, n_parts = frozen_int(np.arange(mesh.n_cells)), mesh.n_cells
        groups, n_groups = _joined_vertices(mesh, most)
    else:
        parts = mesh.check_labels(labels)
        n_parts = int(parts.max(initial=-1)) + 1
        groups, n_groups = frozen_index(np.arange(mesh.n_points)), mesh.n_points
    offsets, members = parts_at_vertices(*mesh.cell_vertices, groups, parts, n_groups, n_parts, most)
    offsets, members = without_contained(frozen_int(offsets), frozen_index(members), n_parts)
    return Patches(frozen_int(offsets), frozen_int(members))


def _joined_vertices(mesh: Mesh, most: int) -> tuple[Index, int]:
    """Group of each point ``(n_points,)`` when the ends of short edges are one; and how many groups.

    Up to three are one, along the shortest edges; none where so many cells meet that all of three such
    vertices might be more than ``most``.
    """
    ends, faces = _edges(mesh)
    lengths = np.linalg.norm(mesh.local_points[ends[:, 1]] - mesh.local_points[ends[:, 0]], axis=1)
    owner, other = mesh.face_cells[faces].T
    diameters = mesh.cell_diameters
    ratio = lengths / np.maximum(diameters[owner], diameters[np.where(other < 0, owner, other)])
    many = np.bincount(mesh.cell_vertices[1], minlength=mesh.n_points) > most // _JOINED
    short = np.flatnonzero((ratio < _SHORT) & ~many[ends].any(axis=1))
    short = short[np.argsort(ratio[short], kind="stable")]
    joined = joined_patches(ends[short], mesh.n_points, most=_JOINED)
    groups = np.empty(mesh.n_points, np.int32)
    groups[joined.parts] = np.repeat(np.arange(len(joined)), np.diff(joined.offsets))
    return frozen_index(groups), len(joined)


def _edges(mesh: Mesh) -> tuple[Int, Int]:
    """Ends of the edges of faces ``(m, 2)``, and the face of each; in 3-D those of several faces repeat."""
    if mesh.dim == 2:
        return mesh.face_pairs, frozen_int(np.arange(mesh.n_faces))
    following = np.arange(1, len(mesh.face_vertices) + 1)
    following[mesh.face_offsets[1:] - 1] = mesh.face_offsets[:-1]
    ends = np.stack((mesh.face_vertices, mesh.face_vertices[following]), axis=1)
    return frozen_int(ends), frozen_int(np.repeat(np.arange(mesh.n_faces), np.diff(mesh.face_offsets)))


def joined_patches(pairs: Int, n_parts: int, *, most: int = 8) -> Patches:
    """Groups of parts, made by uniting pairs in their order as long as no group has more than ``most``.

    Given the pairs of strongly coupled parts, the strongest first, block Gauss–Seidel over the groups does
    what vertex patches do where the cells of a mesh are flat (lines through boundary layers, bundles of
    slivers), in little more time than Gauss–Seidel over single parts: each part is in one group.

    Parameters
    ----------
    pairs : (m, 2) int
    n_parts : int
    most : int

    Returns
    -------
    Patches
        Groups by their smallest parts, which ascend; a part in no pair is a group of its own.

    Raises
    ------
    OptionError
        If a pair holds a number below 0 or above ``n_parts`` − 1.

    Examples
    --------
    >>> import numpy as np
    >>> groups = joined_patches(np.array([[3, 4], [0, 1], [1, 3]]), 5, most=3)
    >>> [groups.parts[a:b].tolist() for a, b in zip(groups.offsets, groups.offsets[1:])]
    [[0, 1], [2], [3, 4]]
    """
    pairs = frozen_int(pairs)
    if pairs.size and (pairs.min() < 0 or pairs.max() >= n_parts):
        raise OptionError(f"pairs hold {pairs.min()} to {pairs.max()}; there are parts 0 to {n_parts - 1}")
    offsets, parts = united(pairs, n_parts, most)
    return Patches(frozen_int(offsets), frozen_int(parts))
