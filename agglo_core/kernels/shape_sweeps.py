"""K-way polish: boundary cells move to where they make parts compact and their interfaces short."""

from __future__ import annotations

import numpy as np

from agglo_core.kernels.compiling import kernel
from agglo_core.kernels.interface import keeps_whole, sort_by_key
from agglo_core.kernels.reach import fits, reaches, take_in

__all__ = ["relax_shapes"]

_SWEEPS = 12
_TIE = 1e-9
_FLAT = 1e-6  # third moments below this share of their bound are rounding


@kernel
def _inertia(graph_cells, tally, owner, energy):
    """Weights, centres and cells of all parts; adds their moments of inertia to their blocks' ``energy``."""
    centroids, weights = graph_cells
    parts, mass, cells, centres = tally
    d = centroids.shape[1]
    for i in range(len(weights)):
        p = parts[i]
        mass[p] += weights[i]
        cells[p] += 1
        for k in range(d):
            centres[p, k] += weights[i] * centroids[i, k]
    for p in range(len(mass)):
        for k in range(d):
            centres[p, k] = centres[p, k] / mass[p] if mass[p] > 0.0 else 0.0
    for i in range(len(weights)):
        p = parts[i]
        for k in range(d):
            energy[owner[p]] += weights[i] * (centroids[i, k] - centres[p, k]) ** 2


@kernel
def _axes(graph_cells, tally, owner, axes):
    """The third moment of each block about its centre; one fixed direction where symmetry leaves none."""
    centroids, weights = graph_cells
    parts, mass, _, centres = tally
    d = centroids.shape[1]
    total, bound = np.zeros(len(axes)), np.zeros(len(axes))
    middle, offset = np.zeros(axes.shape), np.empty(d)
    for p in range(len(owner)):
        total[owner[p]] += mass[p]
        for k in range(d):
            middle[owner[p], k] += mass[p] * centres[p, k]
    for i in range(len(weights)):
        b, square = owner[parts[i]], 0.0
        for k in range(d):
            offset[k] = centroids[i, k] - (middle[b, k] / total[b] if total[b] > 0.0 else 0.0)
            square += offset[k] ** 2
        bound[b] += weights[i] * square * np.sqrt(square)
        for k in range(d):
            axes[b, k] += weights[i] * square * offset[k]
    for b in range(len(axes)):
        length = 0.0
        for k in range(d):
            length += axes[b, k] ** 2
        if np.sqrt(length) <= _FLAT * bound[b]:
            for k in range(d):
                axes[b, k] = 1.0 / (1.0 + np.sqrt(2.0) * k)


@kernel
def _square_distance(x, i, centres, p):
    square = 0.0
    for k in range(x.shape[1]):
        square += (x[i, k] - centres[p, k]) ** 2
    return square


@kernel
def _along(axes, b, x, i):
    place = 0.0
    for k in range(x.shape[1]):
        place += axes[b, k] * x[i, k]
    return place


@kernel
def _best_move(graph, graph_cells, tally, blocks, i, alpha, scratch):
    """The part that cell i should move to, or −1, and what that adds to inertia and interface.

    Blocks may share edges; these stay cut, whatever moves.
    """
    indptr, indices, interface = graph
    centroids, weights = graph_cells
    parts, mass, _, centres = tally
    owner, energy, length, axes = blocks
    share, met = scratch
    home, found, total = parts[i], 0, 0.0
    b = owner[home]
    for h in range(indptr[i], indptr[i + 1]):
        p = parts[indices[h]]
        if owner[p] == b:
            if share[p] == 0.0:
                met[found] = p
                found += 1
            share[p] += interface[h]
            total += interface[h]
    own, rest = share[home], mass[home] - weights[i]
    lost = weights[i] * _square_distance(centroids, i, centres, home)
    lost = lost * mass[home] / rest if rest > 1e-12 * mass[home] else 0.0
    target, best, inertia, cut = -1, 0.0, 0.0, 0.0
    for m in range(found):
        p = met[m]
        shared, share[p] = share[p], 0.0
        if p == home:
            continue
        won = weights[i] * _square_distance(centroids, i, centres, p)
        won = won * mass[p] / (mass[p] + weights[i]) if mass[p] > 0.0 else 0.0
        change = length[b] * (won - lost) + alpha * energy[b] * (own - shared)
        tie = _TIE * (length[b] * (won + lost) + alpha * energy[b] * total)
        if change >= (best if target >= 0 else 0.0) - tie:
            if target < 0 or change > best + tie:
                continue
            if _along(axes, b, centres, p) >= _along(axes, b, centres, target):
                continue
        target, best, inertia, cut = p, change, won - lost, own - shared
    return target, inertia, cut


@kernel
def _paying(graph, graph_cells, tally, blocks, alpha, scratch, cells, m, keys, chosen):
    """Write to ``chosen`` the cells of ``cells[:m]`` worth moving, along their axes; return how many."""
    parts, found = tally[0], 0
    owner, axes = blocks[0], blocks[3]
    for c in range(m):
        i = cells[c]
        if _best_move(graph, graph_cells, tally, blocks, i, alpha, scratch)[0] >= 0:
            chosen[found] = i
            found += 1
            keys[i] = _along(axes, owner[parts[i]], graph_cells[0], i)
    sort_by_key(chosen, keys, found)
    return found


@kernel
def _put(graph_cells, tally, i, target):
    """Move cell i to part ``target``; the sums follow."""
    centroids, weights = graph_cells
    parts, mass, cells, centres = tally
    home, w = parts[i], weights[i]
    left, joined = mass[home] - w, mass[target] + w
    for k in range(centroids.shape[1]):
        if left > 0.0:
            centres[home, k] -= (centroids[i, k] - centres[home, k]) * w / left
        if joined > 0.0:
            centres[target, k] += (centroids[i, k] - centres[target, k]) * w / joined
    parts[i], mass[home], mass[target] = target, left, joined
    cells[home] -= 1
    cells[target] += 1


@kernel
def relax_shapes(
    indptr, indices, interface, centroids, weights, measures, labels, owner, alpha, floor, limit, corners
):
    """Sweeps of single-cell moves that lower, in each block, inertia times interface to the power ``alpha``.

    Parts are numbered through all blocks; part p belongs to block ``owner[p]`` and trades cells with parts
    of that block only. No part is emptied or disconnected, none falls below ``floor`` times its measure at
    entry, and none that is at most ``limit`` wide becomes wider. In each sweep the cells worth moving are
    taken along an axis of their block, so that their numbering does not matter.
    """
    n, k, d = len(weights), len(owner), centroids.shape[1]
    parts = labels.copy()
    graph, graph_cells = (indptr, indices, interface), (centroids, weights)
    tally = (parts, np.zeros(k), np.zeros(k, np.int64), np.zeros((k, d)))
    n_blocks = owner.max() + 1 if k else 0
    blocks = (owner, np.zeros(n_blocks), np.zeros(n_blocks), np.zeros((n_blocks, d)))
    _inertia(graph_cells, tally, owner, blocks[1])
    _axes(graph_cells, tally, owner, blocks[3])
    room, floors = np.zeros(k), np.zeros(k)
    now, later, seen = np.empty(n, np.int64), np.empty(n, np.int64), np.full(n, -1, np.int64)
    search = (np.full(n, -1, np.int64), np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int64))
    scratch, keys = (np.zeros(k), np.empty(n, np.int64)), np.empty(n)
    candidates, stamp = 0, 0
    for i in range(n):
        p, edge = parts[i], False
        room[p] += measures[i]
        for h in range(indptr[i], indptr[i + 1]):
            q = parts[indices[h]]
            if q != p and owner[q] == owner[p]:
                edge = True
                blocks[2][owner[p]] += 0.5 * interface[h]
        if edge:
            later[candidates] = i
            candidates += 1
    for p in range(k):
        floors[p] = floor * room[p]
    reach = reaches(parts, k, limit, corners)
    for sweep in range(_SWEEPS):
        m = _paying(graph, graph_cells, tally, blocks, alpha, scratch, later, candidates, keys, now)
        candidates = 0
        for c in range(m):
            i, home = now[c], parts[now[c]]
            target, inertia, cut = _best_move(graph, graph_cells, tally, blocks, i, alpha, scratch)
            if target < 0 or tally[2][home] < 2 or room[home] - measures[i] < floors[home]:
                continue
            stamp += 1
            if not keeps_whole(graph, parts, i, search, stamp) or not fits(i, target, reach, limit, corners):
                continue
            _put(graph_cells, tally, i, target)
            take_in(i, home, target, reach, limit, corners)
            room[home] -= measures[i]
            room[target] += measures[i]
            blocks[1][owner[home]] += inertia
            blocks[2][owner[home]] += cut
            if seen[i] != sweep:
                seen[i] = sweep
                later[candidates] = i
                candidates += 1
            for h in range(indptr[i], indptr[i + 1]):
                j = indices[h]
                if seen[j] != sweep and owner[parts[j]] == owner[home]:
                    seen[j] = sweep
                    later[candidates] = j
                    candidates += 1
        if candidates == 0:
            break
    return parts
