"""Vertex patches of a distributed mesh: each is complete, and belongs to one rank."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.authoring import Int, Patches, distributed, frozen_int, multigrid
from agglo_petsc.ranks.border_plan import starts_of


def patches_across(mesh: distributed.DistributedMesh, numbers: Int, bounds: Int) -> Patches:
    """Return the patches, sets of parts around the vertices where parts meet. Collective.

    They agree with :func:`agglo_core.multigrid.vertex_patches`, except that at rank borders close vertices
    do not share a patch.

    Parameters
    ----------
    mesh : DistributedMesh
    numbers : (local.n_cells,) int
        Global part number per cell, including ghosts.
    bounds : (ranks + 1,) int
        Rank r has the parts ``bounds[r]:bounds[r + 1]``, and contributes the patches with its parts as
        lowest.

    Returns
    -------
    Patches
        By global part numbers.
    """
    ranks = mesh.ranks
    if ranks.size == 1 and mesh.n_cells == len(np.unique(numbers)):
        return _renumber_parts(multigrid.vertex_patches(mesh.local), numbers)
    # 1. Patches inside, and pairs of points and parts at the borders
    with ranks.together():
        inside, border = _of_own_cells(mesh, numbers), _border_pairs(mesh, numbers)
        to = border[0] % ranks.size
        parcels = {rank: border[:, to == rank] for rank in np.unique(to).tolist()}
    arrived = ranks.exchanged(parcels)
    # 2. Join them, and send each patch to the owner of its lowest part
    with ranks.together():
        pairs = np.concatenate([np.empty((2, 0), np.int64), *arrived.values()], axis=1)
        patches = _join_patches([inside, _around_points(np.unique(pairs, axis=1))])
        owners = np.searchsorted(bounds, patches.parts[patches.offsets[:-1]], side="right") - 1
        patches_by_rank = {
            rank: _select_patches(patches, owners == rank) for rank in np.unique(owners).tolist()
        }
    patches = _join_patches(list(ranks.exchanged(patches_by_rank).values()))
    # 3. Sort, and remove contained patches
    with ranks.together():
        return _without_contained(_sort_patches(patches))


def _of_own_cells(mesh: distributed.DistributedMesh, numbers: Int) -> Patches:
    """Return the vertex patches of this rank's cells, without ghosts."""
    codes = 2 * np.asarray(numbers) + (mesh.owners != mesh.ranks.rank)  # odd: ghosts
    if not len(codes):
        return _join_patches([])
    names, labels = np.unique(codes, return_inverse=True)
    if len(names) == len(codes):  # cells are the parts
        patches = _renumber_parts(multigrid.vertex_patches(mesh.local), frozen_int(codes))
    else:
        patches = _renumber_parts(multigrid.vertex_patches(mesh.local, frozen_int(labels)), frozen_int(names))
    is_own = patches.parts % 2 == 0
    group = np.repeat(np.arange(len(patches)), np.diff(patches.offsets))
    sizes = np.bincount(group[is_own], minlength=len(patches))
    cut = Patches(starts_of(sizes), frozen_int(patches.parts[is_own] // 2))
    return _select_patches(cut, sizes > 1)


def _border_pairs(mesh: distributed.DistributedMesh, numbers: Int) -> Int:
    """Return the points on rank borders, as global ids, paired with the parts of own cells around them."""
    local = mesh.local
    is_own = mesh.owners == mesh.ranks.rank
    between = (local.face_cells[:, 1] >= 0) & (is_own[local.face_cells].sum(axis=1) == 1)
    at_border = np.zeros(local.n_points, bool)
    at_border[local.face_vertices[np.repeat(between, np.diff(local.face_offsets))]] = True
    offsets, vertices = local.cell_vertices
    cells = np.repeat(np.arange(local.n_cells), np.diff(offsets))
    selection = at_border[vertices] & is_own[cells]
    return frozen_int(np.stack((mesh.point_ids[vertices[selection]], numbers[cells[selection]])))


def _around_points(pairs: Any) -> Patches:
    """Return the set of parts at each point, given sorted pairs of points and parts."""
    sizes = np.unique(pairs[0], return_counts=True)[1]
    return _select_patches(
        Patches(starts_of(sizes), frozen_int(pairs[1])), (sizes > 1) & (sizes <= multigrid.MAX_PARTS)
    )


def _sort_patches(patches: Patches) -> Patches:
    """Sort the parts in each patch, and the patches lexicographically."""
    sizes = np.diff(patches.offsets)
    group = np.repeat(np.arange(len(patches)), sizes)
    parts = patches.parts[np.lexsort((patches.parts, group))]
    table = np.full((len(sizes), int(sizes.max(initial=1))), -1)
    table[group, np.arange(len(parts)) - patches.offsets[group]] = parts
    table = np.unique(table, axis=0)  # also sorts
    inside = table >= 0
    return Patches(starts_of(inside.sum(axis=1)), frozen_int(table[inside]))


def _without_contained(patches: Patches) -> Patches:
    """Remove duplicate patches and patches contained in another."""
    sizes = np.diff(patches.offsets)
    columns = np.unique(patches.parts, return_inverse=True)[1]
    shape = (len(sizes), int(columns.max(initial=-1)) + 1)
    holds = sparse.csr_array((np.ones(len(columns)), columns, patches.offsets), shape=shape)
    shared = sparse.coo_array(holds @ holds.T)
    inside = (shared.data == sizes[shared.row]) & (shared.row != shared.col)
    kept = np.ones(len(sizes), bool)
    kept[shared.row[inside]] = False
    return _select_patches(patches, kept)


def _renumber_parts(patches: Patches, names: Int) -> Patches:
    return Patches(patches.offsets, frozen_int(names[patches.parts]))


def _select_patches(patches: Patches, which: Any) -> Patches:
    sizes = np.diff(patches.offsets)
    return Patches(starts_of(sizes[which]), frozen_int(patches.parts[np.repeat(which, sizes)]))


def _join_patches(pieces: list[Patches]) -> Patches:
    sizes = np.concatenate([np.empty(0, np.int64), *(np.diff(piece.offsets) for piece in pieces)])
    return Patches(
        starts_of(sizes),
        frozen_int(np.concatenate([np.empty(0, np.int64), *(piece.parts for piece in pieces)])),
    )
