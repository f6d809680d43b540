"""K-way polish: boundary cells move to where they make parts compact and their interfaces short."""

from __future__ import annotations

import numpy as np

from agglo_core.kernels.compiling import helper, kernel
from agglo_core.kernels.interface import sort_by_key
from agglo_core.kernels.reach import fits, reaches, take_in
from agglo_core.kernels.ring_search import keeps_whole

__all__ = ["relax_shapes"]

_SWEEPS = 12
_TIE = 1e-9


@helper
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


@helper
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
    own, rest, lost = share[home], mass[home] - weights[i], 0.0
    if rest > 1e-12 * mass[home]:
        for k in range(centroids.shape[1]):
            lost += (centroids[i, k] - centres[home, k]) ** 2
        lost *= weights[i] * mass[home] / rest
    target, best, inertia, cut = -1, 0.0, 0.0, 0.0
    for m in range(found):
        p = met[m]
        shared, share[p] = share[p], 0.0
        if p == home:
            continue
        won = 0.0
        if mass[p] > 0.0:
            for k in range(centroids.shape[1]):
                won += (centroids[i, k] - centres[p, k]) ** 2
            won *= weights[i] * mass[p] / (mass[p] + weights[i])
        change = length[b] * (won - lost) + alpha * energy[b] * (own - shared)
        tie = _TIE * (length[b] * (won + lost) + alpha * energy[b] * total)
        if change >= (best if target >= 0 else 0.0) - tie:
            if target < 0 or change > best + tie:
                continue
            ahead = 0.0
            for k in range(centroids.shape[1]):
                ahead += axes[b, k] * (centres[p, k] - centres[target, k])
            if ahead >= 0.0:
                continue
        target, best, inertia, cut = p, change, won - lost, own - shared
    return target, inertia, cut


@helper
def _paying(graph, graph_cells, tally, blocks, alpha, scratch, cells, m, keys, chosen):
    """Write to ``chosen`` the cells of ``cells[:m]`` worth moving, by ``keys``; return how many."""
    found = 0
    for c in range(m):
        i = cells[c]
        if _best_move(graph, graph_cells, tally, blocks, i, alpha, scratch)[0] >= 0:
            chosen[found] = i
            found += 1
    sort_by_key(chosen, keys, found)
    return found


@helper
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


@helper(allocates=True)
def _relaxed(graph, graph_cells, measures, labels, owner, axes, places, alpha, floor, limit, corners):
    n, k = len(labels), len(owner)
    indptr, indices, interface = graph
    parts, keys = labels.copy(), places.copy()  # to be of types that callees are compiled for already
    tally = (parts, np.zeros(k), np.zeros(k, np.int64), np.zeros((k, axes.shape[1])))
    blocks = (owner, np.zeros(len(axes)), np.zeros(len(axes)), axes)
    _inertia(graph_cells, tally, owner, blocks[1])
    room, floors = np.zeros(k), np.zeros(k)
    now, later, seen = np.empty(n, np.int64), np.empty(n, np.int64), np.full(n, -1, np.int64)
    search = (np.empty(n, np.int64), np.empty(n, np.int64), np.full((n, 2), -1, np.int64))
    scratch = (np.zeros(k), np.empty(n, np.int64))
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
            if not keeps_whole(indptr, indices, parts, i, search, stamp):
                continue
            if not fits(i, target, reach, limit, corners):
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


@kernel
def relax_shapes(graph, graph_cells, measures, labels, owner, axes, places, alpha, floor, limit, corners):
    """Sweeps of single-cell moves that lower, in each block, inertia times interface to the power ``alpha``.

    Parts are numbered through all blocks; part p belongs to block ``owner[p]`` and trades cells with parts
    of that block only. No part is emptied or disconnected, none falls below ``floor`` times its measure at
    entry, and none that is at most ``limit`` wide becomes wider. In each sweep the cells worth moving are
    taken by their ``places (n,)`` along the axis of their block, so that their numbering does not matter.
    """
    return _relaxed(graph, graph_cells, measures, labels, owner, axes, places, alpha, floor, limit, corners)
