"""Clusters of unknowns joined by stiff springs, and the differences that loads across them impose."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from agglo_core.arrays import Float, Int, frozen_float, frozen_int

_STIFF = 1e3
#: Least ratio of a stiff entry to the usual entries of the matrix (their lower quartile).
_STEP = 10.0
#: Growth of that ratio where components are not held weakly.
_WEAK = 0.1
#: Most that holds an unknown of a cluster apart from its springs, relative to its diagonal entry.
_LEFT = 0.01
#: Most of b·D⁻¹b that loads across springs leave; where more is left, it is not hidden by their energy.
_MOST = 10_000
#: Unknowns of a cluster. Springs are factorised, which takes long for larger bodies in 3-D.
_FEW = 64
#: Unknowns of a cluster that constants are not free to move, as with scaled unknowns or signs.
_SAMPLE = 4096
#: Entries from which the usual size is estimated.
_HIDDEN = 1e8
#: Least stiffness, relative to the usual entries, that is named as a reason: half of the digits.


class Imposed(NamedTuple):
    """Differences between stiffly joined unknowns.

    Attributes
    ----------
    members : (m,) int
        Unknowns of all clusters except for one in each, its root, of the largest diagonal entry.
    values : (m,) float
        What solves the rows of members, the other unknowns being 0.
    label : (n,) int
        Number of the cluster of each unknown; unknowns of no cluster have numbers of their own.
    """

    members: Int
    values: Float
    label: Int


def imposed_differences(A: Any, b: Float, sizes: Float) -> Imposed | None:
    """Solve clusters of stiffly joined unknowns for the loads across their springs.

    A cluster is a connected component of entries a_ij that are large against the usual ones, whose other
    entries are small. Apart from its springs it is held weakly. Where loads across springs make up nearly all
    of b, energies are those of the springs, and neither residuals nor energies show errors of clusters as a
    whole.

    Parameters
    ----------
    A : (n, n) sparse or array
    b : (n,) float
    sizes : (n,) float
        Sizes of the rows, see :func:`~agglo_core.problems.residuals.row_scales.row_sizes`.

    Returns
    -------
    Imposed or None
        None unless at most a hundredth of b·D⁻¹b is left without loads across springs, D being the sizes.

    Examples
    --------
    >>> import numpy as np
    >>> A = np.diag([2.0, 2.0, 2.0]) - np.eye(3, k=1) - np.eye(3, k=-1)
    >>> A[:2, :2] += 1e6 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    >>> imposed = imposed_differences(A, np.array([-1e6, 1e6, 1.0]), A.diagonal())
    >>> imposed.members, imposed.values.round(5)
    (array([1]), array([1.]))
    >>> imposed_differences(A, np.ones(3), A.diagonal()) is None
    True
    """
    least = _STIFF * _usual_size(A)
    square = b * (b / sizes)
    most, left = _LEFT * float(square.sum()), sizes > least
    if not most > 0.0 or float(square.sum() - square[left].sum()) > most:
        return None  # rows without springs keep their load
    # Loads of clusters that constants move freely add up to little: the sum over all of them is cheap.
    free = left & (np.abs(A @ np.ones(len(b))) <= _WEAK * sizes)
    if 2.0 * square[free].sum() > square[left].sum() and b[free].sum() ** 2 > most * sizes[free].sum():
        return None
    label, constant = _clusters(sparse.csr_array(A), left, least, sizes)
    order = np.lexsort((-sizes, label))
    first = np.append(True, np.diff(label[order]) != 0)
    roots, members = order[first], order[~first]
    if not len(members) or _share(np.bincount(label, b)[label[roots]], sizes[roots], constant[roots]) > most:
        return None
    root = np.empty(len(b), np.int64)
    root[order] = roots[np.cumsum(first) - 1]
    values, forces, stiffness = _solved(sparse.csr_array(A), b, members, root, label)
    # Clusters that are held otherwise are no clusters.
    held = stiffness > _WEAK * sizes
    kept = ~held[root[members]]
    if _share(np.where(held, b, forces)[roots], sizes[roots]) + square[members[~kept]].sum() > most:
        return None
    label = np.where(held[root], label.max() + 1 + np.arange(len(b)), label)
    return Imposed(frozen_int(members[kept]), frozen_float(values[kept]), frozen_int(label))


def _share(forces: Float, sizes: Float, counted: Any = True) -> float:
    """b·D⁻¹b of some forces, those that are ``counted``."""
    return float(np.where(counted, forces * (forces / sizes), 0.0).sum())


def _usual_size(A: Any) -> float:
    """Return the lower quartile of the absolute values of the entries, from a sample."""
    data = np.ravel(A if isinstance(A, np.ndarray) else A.data)
    if len(data) > _SAMPLE:  # at random, as steps may meet the diagonal alone
        data = data[np.random.default_rng(0).integers(len(data), size=_SAMPLE)]
    data = np.abs(data[data != 0.0])
    return float(np.quantile(data, 0.25)) if len(data) else np.inf


def _clusters(A: Any, rows: Any, least: float, sizes: Float) -> tuple[Int, Any]:
    """Number of the cluster of each unknown ``(n,)``, and whether constants move it freely.

    Only unknowns of some ``rows (n,)`` are in clusters. Components that are no clusters may hold smaller
    ones, of stiffer springs.
    """
    n, small = len(sizes), _WEAK * sizes
    label, constant = np.arange(n), np.ones(n, bool)
    i, j, data = _entries(A, rows)
    stiff = (np.abs(data) > least) & (i != j)
    while stiff.any():
        joints = sparse.coo_array((data[stiff], (i[stiff], j[stiff])), shape=(n, n))
        count, found = connected_components(joints, directed=False)
        # Outside of its cluster each unknown has small entries alone; what constants meet are row sums.
        inside = found[i] == found[j]
        outside = np.bincount(i, np.where(inside, 0.0, np.abs(data)), n)
        sums = np.abs(np.bincount(i, np.where(inside, data, 0.0), n))
        apart = np.bincount(found, outside > small, count) == 0
        free = np.bincount(found, sums + outside > small, count) == 0
        members = np.bincount(found, minlength=count)
        good = (apart & (members > 1) & (members <= np.where(free, _MOST, _FEW)))[found]
        label[good], constant[good] = label.max() + 1 + found[good], free[found[good]]
        least = max(_STEP * least, float(np.abs(data[stiff]).min()))
        left = ~good[i] & (sizes[i] > least)
        i, j, data = i[left], j[left], data[left]
        stiff = (np.abs(data) > least) & (i != j)
    return np.unique(label, return_inverse=True)[1], constant


def _entries(A: Any, rows: Any) -> tuple[Int, Int, Float]:
    """Row numbers, column numbers and values of the entries of some ``rows (n,)``."""
    lengths = np.diff(A.indptr)
    if rows.all():
        return np.repeat(np.arange(len(rows)), lengths), A.indices, A.data
    some = np.repeat(rows, lengths)
    return np.repeat(np.flatnonzero(rows), lengths[rows]), A.indices[some], A.data[some]


def _solved(rows: Any, b: Float, members: Int, root: Int, label: Int) -> tuple[Float, Float, Float]:
    """Solve the rows of members, other unknowns being 0.

    Returns
    -------
    values : (m,) float
        Of the members.
    forces, stiffness : (n,) float
        Load and diagonal entry that elimination of the members leaves in the row of each root.
    """
    own = sparse.coo_array(rows[members])
    i, j = own.coords
    inside, place = label[members[i]] == label[j], np.full(len(b), -1)
    place[members] = np.arange(len(members))
    to_root, springs = inside & (place[j] < 0), inside & (place[j] >= 0)
    coupling = np.bincount(i[to_root], own.data[to_root], len(members))
    scale = 1.0 / np.sqrt(rows.diagonal()[members])
    i, j, data = i[springs], place[j[springs]], own.data[springs]
    S = sparse.csc_array((scale[i] * data * scale[j], (i, j)), shape=(len(members), len(members)))
    solved = scale[:, None] * splu(S).solve(scale[:, None] * np.stack([b[members], coupling], axis=1))
    left = [np.bincount(root[members], coupling * each, len(b)) for each in solved.T]
    return solved[:, 0], b - left[0], rows.diagonal() - left[1]


def stiffest_joint(A: Any) -> tuple[int, int] | None:
    """Return two unknowns whose spring hides what else holds them; None if no spring is that stiff.

    In double precision the entries of their rows keep less than eight digits of the rest.

    Examples
    --------
    >>> import numpy as np
    >>> A = np.eye(9)
    >>> A[:2, :2] += 1e9 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    >>> stiffest_joint(A), stiffest_joint(np.eye(9))
    ((0, 1), None)
    """
    sizes = np.asarray(A.diagonal(), dtype=np.float64)
    least = _HIDDEN * _usual_size(A)
    rows, clusters = sparse.csr_array(A), sizes > least
    if not clusters.any():
        return None
    label, _ = _clusters(rows, clusters, least, sizes)
    i, j, data = _entries(rows, clusters)
    joint = (label[i] == label[j]) & (i != j)
    if not joint.any():
        return None
    at = np.flatnonzero(joint)[np.argmax(np.abs(data[joint]))]
    return int(i[at]), int(j[at])
