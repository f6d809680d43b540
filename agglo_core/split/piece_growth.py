"""Recursive bisection of a level by one compiled function, without a graph for each depth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from agglo_core.arrays import Bytes, Index, Int, UInt64, frozen_index, frozen_int
from agglo_core.graph import Graph
from agglo_core.progress import Notify
from agglo_core.refine.connectivity import ConnectivityFixer
from agglo_core.refine.interface import InterfaceRefiner
from agglo_core.split.side_shares import side_shares
from agglo_core.threads import mapped, thread_count

if TYPE_CHECKING:
    from agglo_core.split.piece_splits import CellVertices

_WORK = 4_000_000
"""Number of cells, counted once per split, between two progress reports: about 0.1 s.

A smaller value costs kernel calls (benchmarks/partition.py, with a million cells).
"""

_SMALL = 16_384
"""Approximate cell count of the pieces distributed to threads (benchmarks/threads.py).

Larger pieces are split one after the other, smaller pieces cost more calls.
"""

_TINY = 512
"""Pieces with at most this many cells are split completely before connectivity tests.

A larger value saves tests, but more splits are repeated if a part is disconnected (benchmarks/partition.py).
"""

_PART = 16.0
"""Approximate cell count of a finished piece, for the estimate of progress."""

_ROOM = 256
"""Minimum number of rows by which lists of pieces grow. Fewer rows cost more kernel calls.
Benchmark: benchmarks/constants.py."""

_LAST_STAMP = 2**30
"""Beyond this stamp the 32-bit marks of the cells are reset, well before they overflow."""

_AT_ONCE = 2**24
"""Above this cell count, the work is split into shares, as the marks could overflow within one call."""

_COLUMNS = 5
"""Columns in lists of pieces: ``COLUMNS`` in ``piece_driver``, which is imported late because of numba."""

_DEPTHS = 256
"""Number of counted depths. Long chains may be deeper: these splits count for the last depth."""


class PieceGrowth:
    """Pieces of a graph that a compiled function bisects, refines and repairs until they are finished.

    Large pieces are split one after the other. Pieces below some thousand cells are split completely,
    independently of other pieces.

    Parameters
    ----------
    graph : Graph
    pieces : (n,) int
        Connected initial pieces 0..k−1.
    kernel : callable
        Calls ``piece_driver.split_pieces`` with helpers that load and cut a piece: ``(graph, shape, pieces,
        lists, limits, budget)``.
    floor : float
        Floor of the refinement, negative for no refinement.
    tiny : int
        Pieces with at most this many cells are split completely before connectivity tests.

    Examples
    --------
    >>> from agglo_core.authoring import ConnectivityFixer, InertialBisection
    >>> from agglo_core.progress import ignore_progress
    >>> strip, seeds = agglo.samples.strip(8).graph, np.zeros(1, np.uint64)
    >>> growth = InertialBisection().grow(strip, strip.components(), [], ConnectivityFixer())
    >>> growth.split(frozen_int([4]), seeds, ignore_progress)[0]
    array([0, 0, 1, 1, 2, 2, 3, 3])
    """

    def __init__(
        self, graph: Graph, pieces: Int, kernel: Callable[..., None], floor: float, tiny: int = _TINY
    ) -> None:
        from agglo_core.split.piece_splits import PieceGraph, Pieces, reach_of_cells, units_of

        # One filled array: large arrays get huge memory pages, except arrays from np.zeros.
        tag, cells, self._local, words = np.full((4, graph.n), 0, np.int32)
        reach = words.view(np.float32)
        units = units_of(graph.centroids, graph.weights)
        reach_of_cells(graph.indptr, graph.indices, graph.centroids, units.length, reach)
        csr = graph.indptr, graph.indices, graph.interface
        self._graph = PieceGraph(*csr, graph.centroids, graph.mass, graph.weights, reach, units)
        self._pieces = Pieces(cells, tag, np.full((graph.n, 4), 0, np.int32))
        self._source = graph
        self._kernel, self._floor, self._tiny = kernel, floor, tiny
        self._stamp = 1
        self._list_cells(pieces)

    def _list_cells(self, pieces: Int) -> None:
        """List the cells of the connected pieces ``(n,)``, piece by piece."""
        from agglo_core.compiled.graphs import list_blocks

        cells, tag, count = self._pieces.cells, self._pieces.tag, int(pieces.max(initial=0)) + 1
        if count == 1:
            cells[:] = np.arange(len(pieces), dtype=np.int32)
            offsets = frozen_int([0, len(pieces)])
        else:
            cells[:], offsets = list_blocks(frozen_int(pieces), frozen_int(np.arange(count)), count)
            tag[:] = (2 * offsets[:-1]).astype(np.int32)[pieces]
        self._slices: Callable[[], Int] = lambda: np.stack((offsets[:-1], offsets[1:]), axis=1)

    @classmethod
    def for_components(
        cls,
        graph: Graph,
        pieces: Int,
        kernel: Callable[..., None],
        refiners: Sequence[Any],
        fixer: Any,
        tiny: int = _TINY,
    ) -> PieceGrowth | None:
        """Return a growth object for the built-in refiner and fixer, or None for other components."""
        floors = [r.floor for r in refiners if type(r) is InterfaceRefiner]
        if type(fixer) is not ConnectivityFixer or len(floors) < len(refiners) or len(refiners) > 1:
            return None
        return cls(graph, pieces, kernel, floors[0] if floors else -1.0, tiny)

    def split(self, quotas: Int, seeds: UInt64, notify: Notify) -> tuple[Int, Int]:
        """Split piece i into ``quotas[i]`` connected pieces (see Growth)."""
        return self._split(quotas, 0.0, notify)

    def split_to_size(self, limit: float, seeds: UInt64, notify: Notify) -> tuple[Int, Int]:
        """Split the pieces until only single cells are wider than ``limit``."""
        return self._split(np.zeros(len(seeds), np.int64), limit, notify)

    def _split(self, quotas: Int, limit: float, notify: Notify) -> tuple[Int, Int]:
        """Split each piece into its quota of parts, or into parts no wider than a positive ``limit``.

        Returns as :meth:`split`. Rows in ``todo`` are pieces, with the columns of ``piece_driver``.
        """
        # 1. Reset the marks before they overflow, and set up the lists.
        if self._stamp > _LAST_STAMP:
            self._pieces.marks[:], self._stamp = 0, 1
        self._shape, self._shares = _shape(self._source, limit), side_shares(int(quotas.sum()))
        leaf, tally = np.zeros(len(self._pieces.cells), np.uint8), np.zeros((_DEPTHS, 3), np.int64)
        todo = np.zeros((len(quotas), _COLUMNS), np.int64)
        todo[:, :2], todo[:, 2] = self._slices(), quotas
        sizes = todo[:, 1] - todo[:, 0]
        work = len(leaf) * max(1.0, float(np.log2(sizes.max() / _PART)))

        def handled() -> None:
            pieces, cells, _ = tally.sum(axis=0).tolist()
            notify(min(1.0, cells / work), f"{len(quotas) + pieces:,} parts")

        # 2. Split all pieces, in several threads or in shares where needed.
        if thread_count() > 1 or len(leaf) > _AT_ONCE:
            tiny = self._shared_out(todo, leaf, tally, limit, handled)
        else:
            made, self._stamp = self._advance(todo, leaf, tally, limit, 0, self._tiny, handled)
            tiny = np.concatenate((todo[sizes <= self._tiny], made))
        # 3. Repair tiny pieces with disconnected parts, and number the parts.
        self._mend_tiny(tiny, leaf, tally, limit)
        handled()
        return self._numbered(leaf), frozen_int(tally[tally[:, 0] > 0])

    def _shared_out(
        self, todo: Int, leaf: Bytes, tally: Int, limit: float, handled: Callable[[], None]
    ) -> Int:
        """Split the pieces completely in all threads, and return the tiny pieces cut from larger pieces."""
        small = max(_SMALL, len(leaf) // (4 * thread_count()))
        postponed, stamp = self._halved_together(todo, leaf, tally, limit, small, handled)
        self._stamp, tiny = stamp, [postponed[postponed[:, 1] - postponed[:, 0] <= self._tiny]]

        def finish(batch: Int) -> tuple[Int, Int, int]:
            batch_tally = np.zeros_like(tally)
            return batch_tally, *self._advance(batch, leaf, batch_tally, limit, 0, self._tiny)

        for batch_tally, pieces, last in mapped(finish, _batches(postponed)):
            tiny.append(pieces)
            tally += batch_tally
            stamp = max(stamp, last)
            handled()
        self._stamp = stamp
        return np.concatenate(tiny)

    def _mend_tiny(self, tiny: Int, leaf: Bytes, tally: Int, limit: float) -> None:
        """Split tiny pieces with disconnected parts again, this time with connectivity tests.

        Their counts are undone by a repeated split that counts down.
        """
        broken = np.flatnonzero(leaf > 1)
        if len(broken) == 0:
            return
        tiny = tiny[tiny[:, 0].argsort()]
        broken_pieces = tiny[np.unique(np.searchsorted(tiny[:, 0], broken, "right") - 1)]
        for tested, step in ((self._tiny, -1), (0, 1)):
            for lo, hi in broken_pieces[:, :2].tolist():
                self._pieces.cells[lo:hi].sort()
                leaf[lo:hi] = False
            self._stamp = self._advance(broken_pieces, leaf, tally, limit, 0, tested, step=step)[1]

    def _advance(
        self,
        todo: Int,
        leaf: Bytes,
        tally: Int,
        limit: float,
        postponed_size: int,
        tiny: int,
        handled: Callable[[], None] | None = None,
        stamp: int = 0,
        step: int = 1,
    ) -> tuple[Int, int]:
        """Split mesh pieces until all are finished or postponed.

        Returns the postponed pieces, including tiny pieces cut from larger pieces, and the next stamp.
        """
        from agglo_core.split.piece_driver import STATE, TORN, Limits, Lists

        # 1. Lists with spare rows.
        counts = np.array([len(todo), 0, max(stamp, self._stamp)])
        todo, postponed = _append_rows(todo), np.zeros((_ROOM, _COLUMNS), np.int64)
        limits = Limits(limit, self._floor, postponed_size, tiny, step, self._shares)
        while counts[0]:
            lists = Lists(todo, postponed, leaf, counts, tally)
            # 2. Split until the budget is used, the lists are full, or all pieces are finished or postponed.
            self._kernel(self._graph, self._shape, self._pieces, lists, limits, _WORK)
            # 3. Repair the torn pieces if only these are left.
            if counts[0] == 0 and (torn := postponed[: counts[1], STATE] == TORN).any():
                rows = postponed[: counts[1]]
                todo, whole = _append_rows(self._mended(rows[torn])), rows[~torn]
                postponed[: len(whole)] = whole
                counts[:2] = len(rows) - len(whole), len(whole)
            # 4. Enlarge full lists.
            if counts[0] + 2 > len(todo):
                todo = _append_rows(todo)
            if counts[1] + 2 > len(postponed):
                postponed = _append_rows(postponed)
            if handled is not None:
                handled()
        return postponed[: counts[1]], int(counts[2])

    def _halved_together(
        self, todo: Int, leaf: Bytes, tally: Int, limit: float, small: int, handled: Callable[[], None]
    ) -> tuple[Int, int]:
        """Bisect pieces in parallel, largest first, until all have at most ``small`` cells.

        Returns the pieces and the next stamp.
        """
        stamp = self._stamp

        def halve(piece: Int) -> tuple[Int, Int, int]:
            piece_tally = np.zeros_like(tally)
            return piece_tally, *self._advance(piece[None], leaf, piece_tally, limit, enough, 0, stamp=stamp)

        sizes = todo[:, 1] - todo[:, 0]
        # In each round, halve all pieces above three quarters of the largest size, in parallel.
        while (sizes > small).any():
            enough = max(small, 3 * int(sizes.max()) // 4)
            smaller, last = [todo[sizes <= enough]], stamp
            for piece_tally, halves, following in mapped(halve, todo[sizes > enough]):
                tally += piece_tally
                smaller.append(halves)
                last = max(last, following)
                handled()
            todo, stamp = np.concatenate(smaller), last
            sizes = todo[:, 1] - todo[:, 0]
        return todo, stamp

    def _mended(self, torn: Int) -> Int:
        """Repair pieces with a disconnected side as the built-in fixer does."""
        from agglo_core.refine.repair import mend_sides
        from agglo_core.split.piece_driver import MENDED, QUOTA, STATE

        graph, (cells, tag, _) = self._graph, self._pieces
        csr = graph.indptr, graph.indices, graph.interface
        mend_sides(torn[:, :QUOTA].copy(), cells, tag, *csr, graph.centroids, graph.measures, self._local)
        torn[:, STATE] = MENDED
        return torn

    def _places(self) -> Index:
        """Return, for each cell, a number that identifies its piece."""
        return frozen_index(self._pieces.tag >> 1)

    def _numbered(self, leaf: Bytes) -> Int:
        """Number the finished pieces by first cell, and keep them as the pieces for the next call."""
        from agglo_core.compiled.graphs import number_as_met

        labels, places = number_as_met(self._places(), len(leaf))
        self._slices = lambda: _slices_at(leaf, places)  # computed only if another level follows
        return frozen_int(labels)


def _slices_at(leaf: Bytes, places: Int) -> Int:
    """Return the start and stop in the cell list of each piece that starts or ends at ``places``.

    ``leaf`` marks the starts.
    """
    starts = np.flatnonzero(leaf)
    stops = np.append(starts[1:], len(leaf))
    piece = np.empty(len(leaf), np.int32)
    piece[starts] = piece[stops - 1] = np.arange(len(starts))
    return np.stack((starts, stops), axis=1).take(piece[places], axis=0)


def _shape(graph: Graph, limit: float) -> CellVertices:
    """Return the vertices of the cells, or empty arrays without a size limit.

    A subgraph would load the vertices on first use.
    """
    from agglo_core.split.piece_splits import CellVertices

    if limit > 0.0:
        return CellVertices(graph.vertex_offsets, graph.vertices, graph.points)
    return CellVertices(frozen_int([0]), frozen_index([]), graph.points)


def _append_rows(rows: Int) -> Int:
    return np.concatenate((rows, np.zeros((max(_ROOM, len(rows)), _COLUMNS), np.int64)))


def _batches(todo: Int) -> list[Int]:
    """Divide a list of pieces into batches of some ten thousand cells."""
    full = np.cumsum(todo[:, 1] - todo[:, 0]) // (4 * _SMALL)
    return np.split(todo, np.flatnonzero(np.diff(full)) + 1)
