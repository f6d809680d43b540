"""METIS through pymetis: one call for each bisected block, one call for a k-way partition.

Source: Karypis and Kumar, "A fast and high quality multilevel scheme for partitioning irregular graphs"
(SIAM J. Sci. Comput. 20, 1998).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from agglo_core.anneal.part_search import PartSearch
from agglo_core.authoring import Float, Graph, Index, Int, OptionError, Target, UInt64

if TYPE_CHECKING:
    import pymetis

_UNITS = 1000  # mean integer weight of a block: a larger value rounds less (benchmarks/quality.py)
# Largest ufactor: from 300 (recursive) and 3155 (kway), METIS left halves without nodes and printed a warning
# on some of 5,000 random graphs of up to 300 nodes.
_MAX_UFACTOR = {"kway": 1000, "recursive": 200}
_SEED_MASK = np.uint64(0x7FFFFFFF)  # seed range of METIS on every platform


class Metis:
    """Bisect and partition graphs by the METIS library.

    Parameters
    ----------
    algorithm : {"kway", "recursive"}
        Algorithm for :meth:`partition`: k-way refinement, or repeated bisection (4 to 5 times faster, but
        parts may be disconnected). Bisections are always multilevel recursive bisections.
    vertex_weights, edge_weights : bool
        Balance the node weights (in a run by count the quantity of its ``balance``) instead of their
        number; minimise the interface cut instead of the edge count.
    ufactor : int in 1..1000, with ``algorithm="recursive"`` in 1..200, optional
        Allowed imbalance in thousandths; for larger values METIS makes parts without nodes. Default: 300 for
        k-way (parts become rounder at the cost of balance), METIS' own for bisections.
    contig : bool
        Force connected parts (k-way only).
    niter, ncuts : int in 1..10^4
        Refinement sweeps per level; number of trial partitions, of which the best is kept.
    effort : "quick", "fast", "good" or "best", optional
        Anneal the k-way partition; then a target size is possible, too. Annealing for solvers starts from
        METIS' parts or from bisections, whichever is better.
    objective : "solver" or "roundness"
        Annealing goal, see ``kmeans``.
    seconds : float, optional
        Time limit for annealing.
    balance : float, optional
        Largest relative deviation of annealed part sizes from their mean.
    size : "cells", "measure" or "weights", optional
        Balanced quantity. Default: the run's quantity (its ``weights=`` or ``balance=``), otherwise
        cells.

    Raises
    ------
    OptionError
        If an option has the wrong type or is out of bounds.
    """

    def __init__(
        self,
        algorithm: Literal["kway", "recursive"] = "kway",
        vertex_weights: bool = True,
        edge_weights: bool = True,
        ufactor: int | None = None,
        contig: bool = True,
        niter: int = 10,
        ncuts: int = 1,
        effort: Literal["quick", "fast", "good", "best"] | None = None,
        objective: Literal["solver", "roundness"] = "solver",
        seconds: float | None = None,
        balance: float | None = None,
        size: Literal["cells", "measure", "weights"] | None = None,
    ) -> None:
        if algorithm not in ("kway", "recursive"):
            raise OptionError(f"metis: algorithm must be 'kway' or 'recursive', not {algorithm!r}")
        flags = {"vertex_weights": vertex_weights, "edge_weights": edge_weights, "contig": contig}
        for name, flag in flags.items():
            if not isinstance(flag, bool):
                raise OptionError(f"metis: {name} must be true or false, not {flag!r}")
        if ufactor is not None:
            _check_count("ufactor", ufactor, _MAX_UFACTOR[algorithm])
        _check_count("niter", niter, 10**4)
        _check_count("ncuts", ncuts, 10**4)
        self.algorithm, self.contig = algorithm, contig
        self.vertex_weights, self.edge_weights = vertex_weights, edge_weights
        self.ufactor, self.niter, self.ncuts = ufactor, niter, ncuts
        self.search = PartSearch.checked("metis", effort, objective, seconds, balance, size)

    @property
    def final_parts(self) -> bool:
        """True if refiners and polish must leave the k-way partition unchanged."""
        return self.search is not None

    def bisect_level(self, level: Graph, seeds: UInt64) -> Int:
        """Bisect each block, and return each node's side ``(n,)``, 0 or 1.

        Both sides occur in every block with at least two nodes.
        """
        return self.bisect_shares(level, seeds, None)

    def bisect_shares(self, level: Graph, seeds: UInt64, shares: Float | None) -> Int:
        """Bisect each block so that side 0 gets ``shares (B,)`` of the weight, by default half."""
        # 1. Adjacency and weights, with node numbers local to each block
        ends = level.indptr[level.offsets]
        adjacent = level.indices - np.repeat(level.offsets[:-1], np.diff(ends))
        nodes, edges = self._weights(level)
        sides, options = np.zeros(level.n, dtype=np.int64), self._options(recursive=True)
        # 2. One METIS call per block
        for b, (i, j) in enumerate(zip(level.offsets[:-1], level.offsets[1:], strict=True)):
            if j - i > 1:
                span = slice(ends[b], ends[b + 1])
                starts = level.indptr[i : j + 1] - ends[b]
                weights = _take_span(nodes, slice(i, j)), _take_span(edges, span)
                options.seed = int(seeds[b] & _SEED_MASK)
                share = None if shares is None else [float(shares[b]), 1.0 - float(shares[b])]
                sides[i:j] = _part(2, starts, adjacent[span], *weights, options, recursive=True, shares=share)
        return _with_two_sides(level, sides)

    def partition(self, graph: Graph, target: Target, seed: int) -> Int:
        """Partition one connected graph into ``target.parts`` parts (at most one per node).

        METIS may leave labels unused: for parts with few cells it returns fewer parts than requested. With
        an effort, its parts are the start of a search, and the result meets the target.

        Raises
        ------
        OptionError
            Without ``target.parts`` and without an effort: METIS supports no target sizes.
        """
        if self.search is not None:
            return self.search.parts(graph, target, seed, lambda own, k: self._direct(own, Target(k), seed))
        return self._direct(graph, target, seed)

    def _direct(self, graph: Graph, target: Target, seed: int) -> Int:
        """Return the part labels ``(n,)`` from METIS, without a subsequent search."""
        if target.parts is None or target.parts < 1:
            raise OptionError(f"metis: partition needs a positive number of parts, not {target.parts!r}")
        parts = min(target.parts, graph.n)
        if parts in (1, graph.n):  # METIS would leave gaps among n parts
            return np.arange(graph.n) % parts
        nodes, edges = self._weights(graph)
        recursive = self.algorithm == "recursive"
        nodes = None if nodes is None else _that_fit(nodes, parts)
        options = self._options(recursive)
        options.seed = int(np.uint64(seed) & _SEED_MASK)
        return _part(parts, graph.indptr, graph.indices.astype(np.int64), nodes, edges, options, recursive)

    def _options(self, recursive: bool) -> pymetis.Options:
        """Return the options for a METIS call, except the seed.

        Creating them takes as long as bisecting a few dozen nodes.
        """
        import pymetis

        options = pymetis.Options(niter=self.niter, ncuts=self.ncuts)
        if not recursive:
            options.contig = int(self.contig)
        if self.ufactor is not None or not recursive:
            options.ufactor = self.ufactor or 300
        return options

    def _weights(self, level: Graph) -> tuple[Int | None, Int | None]:
        """Return integer weights of nodes ``(n,)`` and edges ``(m,)``, None for weights switched off."""
        own = level.weights if level.loads is None else level.mass
        nodes = _integers(own, level.offsets) if self.vertex_weights else None
        edges = _integers(level.interface, level.indptr[level.offsets]) if self.edge_weights else None
        return nodes, edges


def _part(
    parts: int,
    starts: Int,
    adjacent: Index,
    nodes: Int | None,
    edges: Int | None,
    options: pymetis.Options,
    recursive: bool,
    shares: list[float] | None = None,
) -> Int:
    """Partition a graph by one METIS call, and return part labels ``(n,)``.

    The parts get the fractions ``shares`` of the weight, by default equal ones.
    """
    import pymetis

    graph = pymetis.CSRAdjacency(starts, adjacent)
    result = pymetis.part_graph(
        parts, graph, vweights=nodes, eweights=edges, tpwgts=shares, recursive=recursive, options=options
    )
    return np.asarray(result.vertex_part, dtype=np.int64)


def _check_count(name: str, value: object, largest: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= largest:
        raise OptionError(f"metis: {name} must be an integer in 1..{largest}, not {value!r}")


def _take_span(values: Int | None, span: slice) -> Int | None:
    return None if values is None else values[span]


def _integers(values: Float, offsets: Int) -> Int:
    """Round values to integers: thousandths of their block's mean, at least 1.

    In a block of zeros all integers are equal.
    """
    sizes = np.diff(offsets)
    totals = np.bincount(np.repeat(np.arange(len(sizes)), sizes), values, len(sizes))
    some = totals > 0
    shares = values / np.repeat(np.where(some, totals, 1.0), sizes)
    if not some.all():
        shares = np.where(np.repeat(some, sizes), shares, 1.0 / np.repeat(sizes, sizes))
    shares *= np.repeat(sizes, sizes)
    integers: Int = np.maximum(np.rint(_UNITS * shares), 1).astype(np.int64)
    return integers


def _that_fit(nodes: Int, parts: int) -> Int | None:
    """Limit node weights to the mean part weight.

    The result is None if parts have fewer than two nodes on average. A node with a limited weight forms a
    part alone. METIS prints complaints if weights leave a half without nodes.
    """
    if 2 * parts > len(nodes):
        return None
    most = int(nodes.max())
    while (share := max(1, int(nodes.sum()) // parts)) < most:  # terminates: the largest decreases each time
        nodes, most = np.minimum(nodes, share), share
    return nodes


def _with_two_sides(level: Graph, sides: Int) -> Int:
    """Split off the heaviest node in blocks where METIS left one side empty.

    This happens if one node outweighs the rest.
    """
    starts, sizes = level.offsets[:-1], np.diff(level.offsets)
    ones = np.add.reduceat(sides, starts)
    empty = np.flatnonzero((sizes > 1) & ((ones == 0) | (ones == sizes)))
    for b in empty:
        i, j = level.offsets[b : b + 2]
        sides[i:j] = np.arange(j - i) == np.argmax(level.weights[i:j])
    return sides
