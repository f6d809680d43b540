"""Clusters of unknowns joined by stiff springs (large entries), and differences imposed by their loads."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from agglo_core.arrays import Float, Int, frozen_float, frozen_int

#: Minimum ratio of a stiff entry to the usual entries (their lower quartile) (benchmarks/constants.py)
_STIFF = 1e3
#: Growth factor for this ratio where components are not weakly held (benchmarks/constants.py)
_STEP = 10.0
#: Maximum outer coupling of an unknown in a cluster, relative to its diagonal entry (benchmarks/constants.py)
_WEAK = 0.1
#: Maximum share of b·D⁻¹b left without loads across springs. A larger rest is not hidden by spring
#: energy (benchmarks/constants.py)
_LEFT = 0.01
#: Maximum unknowns per cluster. Springs are factorised, which is slow for large 3-D bodies
#: (benchmarks/constants.py)
_MOST = 10_000
#: Maximum unknowns per cluster that does not move freely by constants (scaled unknowns, signs)
#: (benchmarks/constants.py)
_FEW = 64
#: Number of sampled entries for the estimate of the usual entry size (benchmarks/constants.py)
_SAMPLE = 4096
#: Minimum stiffness, relative to the usual entries, to be named as a reason: half of the digits
#: (benchmarks/constants.py)
_HIDDEN = 1e8


class Imposed(NamedTuple):
    """Differences between unknowns joined by stiff springs, imposed by loads across the springs.

    Attributes
    ----------
    members : (m,) int
        Unknowns in all clusters, except the root of each cluster (its largest diagonal entry).
    values : (m,) float
        Solution of the member rows, with all other unknowns 0.
    label : (n,) int
        Cluster number per unknown. Unknowns outside clusters have unique numbers.
    """

    members: Int
    values: Float
    label: Int


def imposed_differences(A: Any, b: Float, sizes: Float) -> Imposed | None:
    """Compute the differences that loads across stiff springs impose in clusters of joined unknowns.

    A cluster is a connected component of large entries a_ij, compared with the usual entries, with small
    entries to the outside. Without its springs a cluster is weakly held. If loads across springs dominate b,
    energies are spring energies, and neither residuals nor energies show errors of whole clusters.

    Parameters
    ----------
    A : (n, n) sparse or array
    b : (n,) float
    sizes : (n,) float
        Row sizes (:func:`~agglo_core.problems.residuals.row_scales.row_sizes`).

    Returns
    -------
    Imposed or None
        None unless loads without springs are at most 1 % of b·D⁻¹b, with the row sizes D.

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
    # Quick exit: rows without stiff entries carry too much load.
    least = _STIFF * _usual_size(A)
    square = b * (b / sizes)
    most, has_spring = _LEFT * float(square.sum()), sizes > least
    if not most > 0.0 or float(square.sum() - square[has_spring].sum()) > most:
        return None  # rows without springs keep their load
    # Quick exit: the net load on freely movable clusters must be small, and is cheap to compute.
    free = has_spring & (np.abs(A @ np.ones(len(b))) <= _WEAK * sizes)
    if 2.0 * square[free].sum() > square[has_spring].sum() and b[free].sum() ** 2 > most * sizes[free].sum():
        return None
    # Find the clusters, with the largest diagonal entry as root of each.
    label, constant = _clusters(sparse.csr_array(A), has_spring, least, sizes)
    order = np.lexsort((-sizes, label))
    first = np.append(True, np.diff(label[order]) != 0)
    roots, members = order[first], order[~first]
    if not len(members) or _share(np.bincount(label, b)[label[roots]], sizes[roots], constant[roots]) > most:
        return None
    # Solve the member rows of each cluster.
    root = np.empty(len(b), np.int64)
    root[order] = roots[np.cumsum(first) - 1]
    values, forces, stiffness = _solve_members(sparse.csr_array(A), b, members, root, label)
    # Discard clusters that are held otherwise.
    is_held = stiffness > _WEAK * sizes
    in_cluster = ~is_held[root[members]]
    if _share(np.where(is_held, b, forces)[roots], sizes[roots]) + square[members[~in_cluster]].sum() > most:
        return None
    label = np.where(is_held[root], label.max() + 1 + np.arange(len(b)), label)
    return Imposed(frozen_int(members[in_cluster]), frozen_float(values[in_cluster]), frozen_int(label))


def _share(forces: Float, sizes: Float, counted: Any = True) -> float:
    """Return the contribution of the ``counted`` forces to b·D⁻¹b."""
    return float(np.where(counted, forces * (forces / sizes), 0.0).sum())


def _usual_size(A: Any) -> float:
    """Return the usual entry size: the lower quartile of magnitudes, estimated from a sample."""
    data = np.ravel(A if isinstance(A, np.ndarray) else A.data)
    if len(data) > _SAMPLE:  # at random, because strides may hit the diagonal only
        data = data[np.random.default_rng(0).integers(len(data), size=_SAMPLE)]
    data = np.abs(data[data != 0.0])
    return float(np.quantile(data, 0.25)) if len(data) else np.inf


def _clusters(A: Any, rows: Any, least: float, sizes: Float) -> tuple[Int, Any]:
    """Return the cluster per unknown ``(n,)``, and True where a constant shift costs little energy.

    Only unknowns in the given ``rows (n,)`` belong to clusters. Components that are not clusters may contain
    smaller clusters with stiffer springs.
    """
    n, small = len(sizes), _WEAK * sizes
    label, constant = np.arange(n), np.ones(n, bool)
    i, j, data = _entries(A, rows)
    stiff = (np.abs(data) > least) & (i != j)
    while stiff.any():
        # Connected components of stiff entries.
        joints = sparse.coo_array((data[stiff], (i[stiff], j[stiff])), shape=(n, n))
        count, component = connected_components(joints, directed=False)
        # A cluster has only small entries to the outside. Row sums are the effect of constants.
        inside = component[i] == component[j]
        outside = np.bincount(i, np.where(inside, 0.0, np.abs(data)), n)
        sums = np.abs(np.bincount(i, np.where(inside, data, 0.0), n))
        is_isolated = np.bincount(component, outside > small, count) == 0
        free = np.bincount(component, sums + outside > small, count) == 0
        members = np.bincount(component, minlength=count)
        good = (is_isolated & (members > 1) & (members <= np.where(free, _MOST, _FEW)))[component]
        label[good], constant[good] = label.max() + 1 + component[good], free[component[good]]
        # Raise the stiffness bound for the remaining components.
        least = max(_STEP * least, float(np.abs(data[stiff]).min()))
        undecided = ~good[i] & (sizes[i] > least)
        i, j, data = i[undecided], j[undecided], data[undecided]
        stiff = (np.abs(data) > least) & (i != j)
    return np.unique(label, return_inverse=True)[1], constant


def _entries(A: Any, rows: Any) -> tuple[Int, Int, Float]:
    """Return row indices, column indices and values of the entries in the rows of a mask ``rows (n,)``."""
    lengths = np.diff(A.indptr)
    if rows.all():
        return np.repeat(np.arange(len(rows)), lengths), A.indices, A.data
    some = np.repeat(rows, lengths)
    return np.repeat(np.flatnonzero(rows), lengths[rows]), A.indices[some], A.data[some]


def _solve_members(rows: Any, b: Float, members: Int, root: Int, label: Int) -> tuple[Float, Float, Float]:
    """Solve the rows of all cluster members except the roots, with all other unknowns 0.

    Returns
    -------
    values : (m,) float
        Member values.
    forces, stiffness : (n,) float
        Load and diagonal entry in each root row after elimination of the members.
    """
    # Split the member rows into springs between members and couplings to the roots.
    member_rows = sparse.coo_array(rows[members])
    i, j = member_rows.coords
    inside, place = label[members[i]] == label[j], np.full(len(b), -1)
    place[members] = np.arange(len(members))
    to_root, springs = inside & (place[j] < 0), inside & (place[j] >= 0)
    coupling = np.bincount(i[to_root], member_rows.data[to_root], len(members))
    # Solve the scaled springs for loads and couplings.
    scale = 1.0 / np.sqrt(rows.diagonal()[members])
    i, j, data = i[springs], place[j[springs]], member_rows.data[springs]
    S = sparse.csc_array((scale[i] * data * scale[j], (i, j)), shape=(len(members), len(members)))
    solutions = scale[:, None] * splu(S).solve(scale[:, None] * np.stack([b[members], coupling], axis=1))
    # Eliminate the members from the root rows.
    root_sums = [np.bincount(root[members], coupling * column, len(b)) for column in solutions.T]
    return solutions[:, 0], b - root_sums[0], rows.diagonal() - root_sums[1]


def stiffest_joint(A: Any) -> tuple[int, int] | None:
    """Return the two unknowns joined by the stiffest spring, or None if it hides no other forces.

    In double precision, entries in their rows keep less than eight digits of the other forces.

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
