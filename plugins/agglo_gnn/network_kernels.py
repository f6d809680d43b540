"""The network of the fast model, one piece at a time: columns are bins, so that loops along them are long."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper, kernel

__all__ = ["direction", "network_room", "point"]

_NODE, _WIDTH, _BLOCK, _DENSE = 4, 16, 13, 48  # features of bins, of layers, of pieces, of dense layers
_POOLED = 32  # features of layers and pieces, filled up to a multiple of 8


@helper(reorder_sums=True)
def _add_product(rows, columns, a, b, out):
    """``out += aᵀ b``, eight rows of a and b at a time: their number is a multiple of 8."""
    for o in range(rows):
        for k in range(0, len(a), 8):
            p, q, r, s = a[k, o], a[k + 1, o], a[k + 2, o], a[k + 3, o]
            t, u, v, w = a[k + 4, o], a[k + 5, o], a[k + 6, o], a[k + 7, o]
            for c in range(columns):
                some = p * b[k, c] + q * b[k + 1, c] + r * b[k + 2, c] + s * b[k + 3, c]
                more = t * b[k + 4, c] + u * b[k + 5, c] + v * b[k + 6, c] + w * b[k + 7, c]
                out[o, c] += some + more


@helper
def _sage(count, spots, shares, weight, bias, given, out):
    """``out = ReLU(weightᵀ given + bias)``; the lower half of given: means over neighbours of the upper."""
    half = len(given) // 2
    for k in range(half):
        given[k, count] = 0.0  # what spots without a bin point to
        for a in range(count):
            first, second = given[k, spots[0, a]], given[k, spots[1, a]]
            third, fourth = given[k, spots[2, a]], given[k, spots[3, a]]
            given[half + k, a] = shares[a] * ((first + second) + (third + fourth))
    for o in range(_WIDTH):
        for a in range(count):
            out[o, a] = bias[o]
    _add_product(_WIDTH, count, weight, given, out)
    for o in range(_WIDTH):
        for a in range(count):
            out[o, a] = max(out[o, a], 0.0)


@helper
def _dense(given, weight, bias, out):
    """``out = ReLU(weightᵀ given + bias)``; given is a column, out a row and then a column."""
    row, column = out
    for o in range(_DENSE):
        row[0, o] = bias[o]
    _add_product(1, _DENSE, given, weight, row)
    for o in range(_DENSE):
        column[o, 0] = max(row[0, o], 0.0)


@helper(allocates=True)
def _stacked(upper, lower, rows):
    """Rows of one matrix above those of another, and zeros below."""
    both, split = np.zeros((rows, upper.shape[1])), len(upper)
    for k in range(split + len(lower)):
        for o in range(upper.shape[1]):
            both[k, o] = upper[k, o] if k < split else lower[k - split, o]
    return both


@helper(allocates=True)
def network_room(bins, net):
    """Weights in the shapes the products want, and work arrays for pieces of at most so many bins."""
    own1, other1, _, own2, other2, _, dense1, _, _, _, _, _ = net
    weights = (
        _stacked(own1, other1, 2 * _NODE),
        _stacked(own2, other2, 2 * _WIDTH),
        _stacked(dense1, dense1[:0], _POOLED),
    )
    layers = np.empty((2 * _NODE, bins + 1)), np.empty((2 * _WIDTH, bins + 1)), np.empty((_WIDTH, bins))
    dense = np.zeros((_POOLED, 1)), np.empty((1, _DENSE)), np.empty((_DENSE, 1)), np.empty((_DENSE, 1))
    return weights, (np.empty((4, bins), np.int32), np.empty(bins)), layers, dense


@helper(reorder_sums=True)
def _pool(count, areas, layer, features, pooled):
    for o in range(_WIDTH):
        total = 0.0
        for a in range(count):
            total += areas[a] * layer[o, a]
        pooled[o, 0] = total
    for k in range(_BLOCK):
        pooled[_WIDTH + k, 0] = features[k]


@helper
def point(count, nodes, near, areas, features, net, room):
    """The network: coefficients (c₁, c₂) of the logit c₁ u + c₂ v of a piece of so many bins."""
    _, _, bias1, _, _, bias2, _, add1, dense2, add2, dense3, add3 = net
    (weight1, weight2, dense1), (spots, shares), (given, first, second), (pooled, row, hidden, again) = room
    for a in range(count):
        degree = 0
        for s in range(4):
            degree += near[a, s] >= 0
            spots[s, a] = near[a, s] if near[a, s] >= 0 else count
        shares[a] = 1.0 / max(degree, 1)
        for k in range(_NODE):
            given[k, a] = nodes[a, k]
    _sage(count, spots, shares, weight1, bias1, given, first)
    _sage(count, spots, shares, weight2, bias2, first, second)
    _pool(count, areas, second, features, pooled)
    _dense(pooled, dense1, add1, (row, hidden))
    _dense(hidden, dense2, add2, (row, again))
    p, q = add3[0], add3[1]
    for k in range(_DENSE):
        p += again[k, 0] * dense3[k, 0]
        q += again[k, 0] * dense3[k, 1]
    return p, q


@kernel
def direction(count, nodes, near, areas, features, net):
    """What :func:`point` says, from Python."""
    return point(count, nodes, near, areas, features, net, network_room(count, net))
