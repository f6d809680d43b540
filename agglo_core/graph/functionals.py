"""Cut, volume, normalised cut of a partition, and expectations for label probabilities (paper, §2.1).

As in the paper, edges have weight 1 and nodes their degree, unless weights are given: ``graph.interface`` as
edge weights turns cuts into lengths, ``graph.measures`` as node weights turns volumes into areas.

>>> from agglo_core import functionals, samples
>>> graph = samples.squares(2).graph
>>> functionals.part_cuts(graph, [0, 0, 1, 1])
array([2., 2.])
>>> functionals.normalised_cut(graph, [0, 0, 1, 1])
1.0
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from agglo_core.arrays import Float, Int, exact_cast, plain_array
from agglo_core.errors import OptionError

if TYPE_CHECKING:
    from agglo_core.graph import Graph

__all__ = [
    "cut",
    "degrees",
    "expected_cuts",
    "expected_normalised_cut",
    "expected_volumes",
    "normalised_cut",
    "part_cuts",
    "part_volumes",
]


def degrees(graph: Graph, *, edge_weights: Float | None = None) -> Float:
    """Return the edge weight sum at each node ``(n,)``: D in the paper, the degree if unweighted.

    Examples
    --------
    >>> agglo.functionals.degrees(agglo.samples.squares(2).graph)
    array([2., 2., 2., 2.])
    """
    return np.asarray(_adjacency(graph, edge_weights).sum(axis=1), dtype=float)


def part_cuts(graph: Graph, labels: ArrayLike, *, edge_weights: Float | None = None) -> Float:
    """Return cut(S_k, V∖S_k) of each part ``(k,)``: the weight of its outgoing edges.

    Parameters
    ----------
    graph : Graph
    labels : (n,) int
        Part per node, 0..k−1.
    edge_weights : (m,) float, optional
        One per CSR entry, symmetric; 1 by default.

    Examples
    --------
    >>> graph = agglo.samples.squares(2).graph
    >>> agglo.functionals.part_cuts(graph, np.array([0, 0, 1, 1]))
    array([2., 2.])
    """
    parts = _check_labels(graph, labels)
    rows = np.repeat(parts, np.diff(graph.indptr))
    weights = (rows != parts[graph.indices]) * _edge_weights(graph, edge_weights)
    return _sums(rows, weights, int(parts.max()) + 1)


def part_volumes(
    graph: Graph,
    labels: ArrayLike,
    *,
    edge_weights: Float | None = None,
    node_weights: Float | None = None,
) -> Float:
    """Return vol(S_k, V) of each part ``(k,)``: the sum of node weights ``(n,)``, by default the degrees.

    Examples
    --------
    >>> graph = agglo.samples.squares(2).graph
    >>> agglo.functionals.part_volumes(graph, np.array([0, 0, 1, 1]))
    array([4., 4.])
    """
    parts = _check_labels(graph, labels)
    weights = degrees(graph, edge_weights=edge_weights) if node_weights is None else node_weights
    return _sums(parts, weights, int(parts.max()) + 1)


def cut(graph: Graph, labels: ArrayLike, *, edge_weights: Float | None = None) -> float:
    """Return cut(S_1, …, S_M) = ½ Σ_k cut(S_k, V∖S_k): the weight of the edges between parts, each once.

    Examples
    --------
    >>> graph = agglo.samples.squares(2).graph
    >>> agglo.functionals.cut(graph, np.array([0, 0, 1, 1]))
    2.0
    """
    return 0.5 * float(part_cuts(graph, labels, edge_weights=edge_weights).sum())


def normalised_cut(
    graph: Graph,
    labels: ArrayLike,
    *,
    edge_weights: Float | None = None,
    node_weights: Float | None = None,
) -> float:
    """Return Ncut(S_1, …, S_M) = Σ_k cut(S_k, V∖S_k) / vol(S_k, V).

    Parts without volume add 0.

    Examples
    --------
    >>> graph = agglo.samples.squares(2).graph
    >>> agglo.functionals.normalised_cut(graph, np.array([0, 0, 1, 1]))
    1.0
    """
    cuts = part_cuts(graph, labels, edge_weights=edge_weights)
    volumes = part_volumes(graph, labels, edge_weights=edge_weights, node_weights=node_weights)
    return float(ratio(cuts, volumes).sum())


def expected_cuts(graph: Graph, Y: ArrayLike, *, edge_weights: Float | None = None) -> Float:
    """Return E[cut(S_k, V∖S_k)] = Σ_ij Y_ik (1 − Y_jk) A_ij of each part ``(M,)``.

    ``Y`` is ``(n, M)``: Y_ik is the probability that node i belongs to part k, drawn independently.

    Examples
    --------
    >>> from agglo_core import samples
    >>> from agglo_core.graph.functionals import expected_cuts
    >>> graph = samples.squares(2).graph
    >>> expected_cuts(graph, [[1, 0], [1, 0], [0, 1], [0, 1]])  # no doubt: two of the four edges are cut
    array([2., 2.])
    >>> expected_cuts(graph, [[0.5, 0.5]] * 4)  # each edge with probability 1/2
    array([2., 2.])
    """
    probabilities = _check_probabilities(graph, Y)
    adjacency = _adjacency(graph, edge_weights)
    degree = np.asarray(adjacency.sum(axis=1), dtype=float)
    return np.asarray((probabilities * (degree[:, None] - adjacency @ probabilities)).sum(axis=0))


def expected_volumes(
    graph: Graph, Y: ArrayLike, *, edge_weights: Float | None = None, node_weights: Float | None = None
) -> Float:
    """Return E[vol(S_k, V)] = (Yᵀ D)_k = Γ_k of each part ``(M,)``, with D the degrees or ``node_weights``.

    Examples
    --------
    >>> from agglo_core import samples
    >>> from agglo_core.graph.functionals import expected_volumes
    >>> expected_volumes(samples.squares(2).graph, [[1, 0], [1, 0], [0, 1], [0, 1]])
    array([4., 4.])
    """
    weights = degrees(graph, edge_weights=edge_weights) if node_weights is None else node_weights
    return _check_probabilities(graph, Y).T @ weights


def expected_normalised_cut(
    graph: Graph, Y: ArrayLike, *, edge_weights: Float | None = None, node_weights: Float | None = None
) -> float:
    """Return Σ_ij [(Y ⊘ Γ)(1 − Y)ᵀ ⊙ A]_ij: the sum of expected cuts over expected volumes.

    The paper calls this value the expected normalised cut. It is a ratio of expectations, and equals the
    normalised cut where Y is 0 or 1.

    Examples
    --------
    >>> from agglo_core import samples
    >>> from agglo_core.graph.functionals import expected_normalised_cut
    >>> expected_normalised_cut(samples.squares(2).graph, [[1, 0], [1, 0], [0, 1], [0, 1]])  # 2/4 + 2/4
    1.0
    """
    cuts = expected_cuts(graph, Y, edge_weights=edge_weights)
    volumes = expected_volumes(graph, Y, edge_weights=edge_weights, node_weights=node_weights)
    return float(ratio(cuts, volumes).sum())


def ratio(cuts: Float, volumes: Float) -> Float:
    """Return ``cuts / volumes``, 0 where the volume is 0."""
    return np.divide(cuts, volumes, out=np.zeros_like(cuts), where=volumes > 0)


def _sums(parts: Int, weights: Float, k: int) -> Float:
    sums = np.bincount(parts, weights, minlength=k)
    return sums.astype(np.float64)  # numpy returns integers for empty input


def _edge_weights(graph: Graph, edge_weights: Float | None) -> Float:
    if edge_weights is None:
        return np.ones(len(graph.indices))
    if np.shape(edge_weights) != graph.indices.shape:
        raise OptionError(f"edge_weights must have shape {graph.indices.shape}, not {np.shape(edge_weights)}")
    return exact_cast(
        plain_array(edge_weights, "edge_weights", OptionError), np.float64, "edge_weights", OptionError
    )


def _adjacency(graph: Graph, edge_weights: Float | None) -> sparse.csr_array[Any, Any]:
    weights = _edge_weights(graph, edge_weights)
    return sparse.csr_array((weights, graph.indices, graph.indptr), shape=(graph.n, graph.n))


def _check_labels(graph: Graph, labels: ArrayLike) -> Int:
    array = plain_array(labels, "labels", OptionError)
    if array.shape != (graph.n,) or array.dtype.kind not in "iu" or array.min() < 0:
        raise OptionError(f"labels must be ({graph.n},) integers >= 0; given {array.shape}, {array.dtype}")
    return array


def _check_probabilities(graph: Graph, Y: ArrayLike) -> Float:
    array = exact_cast(plain_array(Y, "Y", OptionError), np.float64, "Y", OptionError)
    if array.ndim != 2 or len(array) != graph.n:
        raise OptionError(f"Y must have shape ({graph.n}, M), one row per node; given {array.shape}")
    if not ((array >= 0) & (array <= 1)).all():
        raise OptionError(f"Y must hold probabilities in [0, 1]; given {array.min():g} to {array.max():g}")
    return array
