"""Enforce bounds on whole parts by splitting parts and joining neighbours."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from agglo_core.agglomeration.goals import CountGoal, Goal
from agglo_core.agglomeration.run import Run
from agglo_core.arrays import Float, Int, Mask, frozen_int, label_order, plain_array
from agglo_core.errors import OptionError, PluginError
from agglo_core.graph import Graph
from agglo_core.progress import phase
from agglo_core.registry.attribution import Member, attributed

Refused = Callable[[Int, Mask], Mask]
"""``refused(labels, examined)`` returns a mask of inadmissible parts among the parts ``examined (k,)``."""

Pairs = set[tuple[int, int]]


def merge_pairs(
    graph: Graph,
    blocks: Int,
    labels: Int,
    wanted: Callable[[Graph, Int], Mask],
    refused: Refused,
    *,
    most: int | None = None,
    by_interface: bool = False,
) -> Int:
    """Merge marked parts with neighbours in their block, and return the labels ``(n,)`` without gaps.

    The lightest pairs merge first. Each part joins its lightest neighbour, or the neighbour with the longest
    interface. In each round a part merges at most once. Refused unions are undone and not tried again.

    Parameters
    ----------
    wanted : callable
        ``wanted(parts, labels)`` returns a mask ``(k,)`` of quotient-graph nodes that need a neighbour.
    refused : callable
    most : int, optional
        Largest number of merges. Default: no limit.
    """
    refused_pairs: Pairs = set()
    budget = graph.n if most is None else most
    while budget > 0:
        # 1. Propose pairs on the quotient graph, and keep disjoint pairs.
        parts = graph.coarsen(labels)
        block = np.empty(parts.n, np.int64)
        block[labels] = blocks
        pairs = _proposals(parts, block, wanted(parts, labels), refused_pairs, by_interface)
        pairs = _apart(pairs, parts.n)[:budget]
        if len(pairs) == 0:
            break
        # 2. Join the pairs, and undo the refused unions.
        labels, n_merged, refused_pairs = _join_pairs(labels, parts.n, pairs, refused, refused_pairs)
        budget -= n_merged
    return frozen_int(labels)


def _proposals(parts: Graph, block: Int, part_mask: Mask, refused_pairs: Pairs, by_interface: bool) -> Int:
    """Pair each part in ``part_mask`` with its best neighbour: pairs ``(q, 2)``, lightest first."""
    # 1. Edges from these parts to neighbours in their block, except refused pairs.
    rows = np.repeat(np.arange(parts.n), np.diff(parts.indptr))
    columns = parts.indices.astype(np.int64)
    edge_mask = part_mask[rows] & (block[rows] == block[columns])
    if refused_pairs:
        pairs = np.array(sorted(refused_pairs))
        keys = np.concatenate((pairs @ (parts.n, 1), pairs @ (1, parts.n)))
        edge_mask &= ~np.isin(rows * parts.n + columns, keys)
    rows, columns = rows[edge_mask], columns[edge_mask]
    # 2. Best neighbour of each part.
    merit: Float = parts.interface[edge_mask] if by_interface else -parts.mass[columns]
    order = np.lexsort((columns, -merit, rows))
    best = order[np.unique(rows[order], return_index=True)[1]]
    # 3. Order the pairs by their mass.
    urgent = np.argsort(parts.mass[rows[best]] + parts.mass[columns[best]], kind="stable")
    picks = best[urgent]
    return frozen_int(np.stack((rows[picks], columns[picks]), axis=1).reshape(-1, 2))


def _apart(pairs: Int, n: int) -> Int:
    """Select disjoint pairs: those that precede all other pairs with a common part."""
    rank = np.arange(len(pairs))
    first = np.full(n, len(pairs))
    np.minimum.at(first, pairs.ravel(), np.repeat(rank, 2))
    return frozen_int(pairs[(first[pairs] == rank[:, None]).all(axis=1)])


def _join_pairs(
    labels: Int, count: int, pairs: Int, refused: Refused, refused_pairs: Pairs
) -> tuple[Int, int, Pairs]:
    """Join the pairs of parts whose union the rules admit.

    Returns the labels, the joined-pair count, and the refused unions. A refused union stays refused when it
    grows.
    """
    # 1. Join all pairs, and find the refused unions.
    whole = _numbers(pairs, count)
    check_mask = np.zeros(count - len(pairs), bool)
    check_mask[whole[pairs[:, 1]]] = True
    bad = refused(frozen_int(whole[labels]), check_mask)[whole[pairs[:, 1]]]
    # 2. Join only the admitted pairs, and renumber the refused ones.
    number = _numbers(pairs[~bad], count)
    old_pairs = {(min(pair), max(pair)) for pair in (*refused_pairs, *map(tuple, pairs[bad].tolist()))}
    refused_pairs = {(int(number[a]), int(number[b])) for a, b in old_pairs}
    return frozen_int(number[labels]), int(np.count_nonzero(~bad)), refused_pairs


def _numbers(pairs: Int, count: int) -> Int:
    """Return the new index per part ``(count,)``, without gaps, after joining the pairs."""
    into = np.arange(count)
    into[pairs[:, 0]] = pairs[:, 1]
    return np.unique(into, return_inverse=True)[1]


_ROUNDS = 8
"""Maximum number of rounds of splitting and joining to meet a count.

With more rounds fewer counts are missed, but a count that the rules forbid takes longer to fail.
Benchmark: benchmarks/constants.py.
"""

_STAGE = 1 << 20
"""Offset of the stage of a level, so that its seeds are distinct."""


@dataclass(frozen=True)
class PartRules:
    """Constraints on whole parts, with the map from cells to nodes of the labelled graph.

    Attributes
    ----------
    graph : Graph
        All cells, as passed to the constraints.
    members : sequence of Member
        Constraints with ``admissible`` or ``incomplete``.
    through : (n,) int
        Node per cell in the labelled graph.
    """

    graph: Graph
    members: Sequence[Member]
    through: Int

    def via(self, nodes: Int) -> PartRules:
        """Return the rules for labels on a new graph, where ``nodes[i]`` is the node that contains node i."""
        return replace(self, through=frozen_int(nodes[self.through]))

    def inadmissible(self, labels: Int) -> Mask:
        """Return a mask ``(k,)`` of the parts that violate a rule and must be split."""
        return ~self._asked("admissible", labels, np.logical_and, fill=True)

    def incomplete(self, labels: Int) -> Mask:
        """Return a mask ``(k,)`` of the parts that violate a rule and should join a neighbour."""
        return self._asked("incomplete", labels, np.logical_or, fill=False)

    def kept(self, graph: Graph, blocks: Int, labels: Int, goal: Goal, run: Run, stage: int) -> Int:
        """Enforce the rules on a level within its ``blocks (n,)``, and return the new labels.

        Raises
        ------
        OptionError
            If no level with the requested count was found.
        """
        with run.statistics.timed("rules"), phase(run.progress, "keeping the constraints"):
            # 1. Even out the parts of an exact count, where a rule supports it.
            level = _Level(self, graph, blocks, goal, run, stage)
            labels = level.evened(labels) if isinstance(goal, CountGoal) else labels
            # 2. Split inadmissible parts, and join the pieces and the small parts with neighbours.
            labels = level.join_split(labels, level.split(labels))
            labels = level.join_small(labels)
            # 3. Restore the count by further splits or merges.
            if isinstance(goal, CountGoal):
                labels = level.to_count(labels, goal)
            # 4. Refuse the level if a rule is still violated.
            self._refuse_inadmissible(labels)
            run.statistics.small_parts += int(np.count_nonzero(self.incomplete(labels)))
        return labels

    def _refuse_inadmissible(self, labels: Int) -> None:
        """Raise OptionError if a part violates the rules but could not be split.

        Causes are lines, finer-level parts, and inconsistent rules.
        """
        bad = self.inadmissible(labels) & (np.bincount(labels[self.through]) > 1)
        if bad.any():
            titles = ", ".join(member.title for member in self.members)
            raise OptionError(
                f"{int(np.count_nonzero(bad))} parts violate the constraints ({titles}) and "
                "cannot be split: they are whole lines of cells or parts of a finer level, "
                "or a constraint gives inconsistent answers"
            )

    def _asked(self, method: str, labels: Int, join: Callable[..., Mask], *, fill: bool) -> Mask:
        of_cells = frozen_int(labels[self.through])
        answer = np.full(int(labels.max()) + 1, fill)
        for member in self.members:
            if callable(getattr(member.tool, method, None)):
                answer = join(answer, _answer(member, method, self.graph, of_cells, len(answer)))
        return answer


def part_rules(graph: Graph, constraints: Sequence[Member]) -> PartRules | None:
    """Collect the constraints on whole parts, or return None if there are none."""
    asking = [
        member
        for member in constraints
        if any(callable(getattr(member.tool, name, None)) for name in ("admissible", "incomplete"))
    ]
    return PartRules(graph, asking, frozen_int(np.arange(graph.n))) if asking else None


@dataclass(frozen=True)
class _Level:
    """One level on which the rules for whole parts are enforced."""

    rules: PartRules
    graph: Graph
    blocks: Int
    goal: Goal
    run: Run
    stage: int

    def evened(self, labels: Int) -> Int:
        """Move cells between parts by the rules that have a method ``evened``, at unchanged part count."""
        if not (self.rules.inadmissible(labels) | self.rules.incomplete(labels)).any():
            return labels
        block = np.empty(int(labels.max()) + 1, np.int64)
        block[labels] = self.blocks
        for member in self.rules.members:
            if callable(getattr(member.tool, "evened", None)):
                with attributed(member.title):
                    where = self.rules.through, self.rules.graph
                    labels = member.tool.evened(self.graph, labels, frozen_int(block), *where)
        return labels

    def split(self, labels: Int) -> Int:
        """Split parts until no part with several nodes violates the rules."""
        for turn in range(self.graph.n):
            bad = self.rules.inadmissible(labels) & (np.bincount(labels) > 1)
            if not bad.any():
                break
            self.run.statistics.split_parts += int(np.count_nonzero(bad))
            labels = self._halved(labels, bad, turn)
        return labels

    def join_split(self, before: Int, labels: Int) -> Int:
        """Join pieces from split parts with neighbours, where the rules admit the union."""
        if isinstance(self.goal, CountGoal) or labels.max() == before.max():
            return labels
        pieces = np.unique(np.stack((before, labels)), axis=1)[0]
        cells = np.flatnonzero((np.bincount(pieces) > 1)[before])

        def split(parts: Graph, labels: Int) -> Mask:
            found = np.zeros(parts.n, bool)
            found[labels[cells]] = True
            return found

        return merge_pairs(self.graph, self.blocks, labels, split, self._refused, by_interface=True)

    def join_small(self, labels: Int) -> Int:
        """Join each small part with the neighbour of longest interface whose union the rules admit."""
        if not self.rules.incomplete(labels).any():
            return labels

        def small(_: Graph, labels: Int) -> Mask:
            return self.rules.incomplete(labels)

        return merge_pairs(self.graph, self.blocks, labels, small, self._refused, by_interface=True)

    def to_count(self, labels: Int, goal: CountGoal) -> Int:
        """Split or merge parts to reach the goal's count.

        For a count that is not exact, get as close as the rules allow.
        """
        start, count = labels, goal.parts
        for turn in range(_ROUNDS):
            k = int(labels.max()) + 1
            if k == count:
                break
            # 1. Too many parts: merge the lightest pairs.
            if k > count:
                labels = self._fewer(labels, k - count)
                if int(labels.max()) + 1 > count:
                    break
            else:
                # 2. Too few parts: halve the heaviest parts, split inadmissible pieces, join small pieces.
                labels = self.split(self._more(labels, count - k, turn))
                labels = self.join_small(labels) if turn < _ROUNDS - 2 or not goal.exact else labels
        k = int(labels.max()) + 1
        if not goal.exact:
            return start if k < count else labels  # splitting only created parts that had to be joined again
        if k == count:
            return labels
        titles = ", ".join(member.title for member in self.rules.members)
        raise OptionError(
            f"cannot find {count} parts that satisfy the constraints ({titles}): the search ended at {k}"
        )

    def _fewer(self, labels: Int, surplus: int) -> Int:
        def everybody(parts: Graph, _: Int) -> Mask:
            return np.ones(parts.n, bool)

        return merge_pairs(self.graph, self.blocks, labels, everybody, self._refused, most=surplus)

    def _more(self, labels: Int, missing: int, turn: int) -> Int:
        """Bisect the heaviest parts, as many as are ``missing``."""
        mass = np.bincount(labels, self.graph.mass) * (np.bincount(labels) > 1)
        heaviest = np.argsort(-mass, kind="stable")[:missing]
        chosen = np.zeros(len(mass), bool)
        chosen[heaviest[mass[heaviest] > 0]] = True
        return self._halved(labels, chosen, _ROUNDS + turn, by_rule=False) if chosen.any() else labels

    def _refused(self, labels: Int, check_mask: Mask) -> Mask:
        bad = self.rules.inadmissible(labels)
        if np.isfinite(self.goal.limit):
            bad |= self.graph.wide_parts(labels, self.goal.limit, check_mask)
        return bad

    def _halved(self, labels: Int, part_mask: Mask, turn: int, *, by_rule: bool = True) -> Int:
        """Split the parts in ``part_mask`` in two, or into more pieces where a rule defines the split."""
        sides = np.zeros(len(labels), np.int64)
        open_parts = part_mask.copy()
        # 1. Splits defined by the rules.
        for member in self.rules.members if by_rule else ():
            if callable(getattr(member.tool, "halves", None)):
                with attributed(member.title):
                    halves = member.tool.halves(self.graph, labels, self.rules.through)
                    cell_labels = plain_array(halves, "the result of halves", PluginError)
                sides = np.where(open_parts[labels], cell_labels, sides)
                open_parts &= ~_in_two(labels, sides, len(part_mask))
        # 2. The other parts are bisected by the components of the run.
        sides = sides * part_mask[labels]
        if open_parts.any():
            cells = np.flatnonzero(open_parts[labels])
            cell_labels = np.unique(labels[cells], return_inverse=True)[1]
            order = label_order(frozen_int(cell_labels))
            offsets = np.concatenate(([0], np.cumsum(np.bincount(cell_labels))))
            level = self.graph.subgraph(cells[order], offsets)
            seeds = self.run.seeds(_STAGE + (self.stage << 8) + turn, level.n_blocks)
            sides[cells[order]] = self.run.halve(level, seeds, self.goal.target)
        # 3. The connected components of all sides are the new parts.
        return self.graph.components(frozen_int(2 * labels + sides))


def _in_two(labels: Int, sides: Int, k: int) -> Mask:
    """Return a mask ``(k,)`` of parts with nodes on both sides."""
    ones = np.bincount(labels, sides, k)
    return (ones > 0) & (ones < np.bincount(labels, minlength=k))


def _answer(member: Member, method: str, graph: Graph, labels: Int, count: int) -> Mask:
    with attributed(member.title):
        answer = getattr(member.tool, method)(graph, labels)
        mask = plain_array(answer, f"the result of {method}", PluginError)
    if mask.shape != (count,) or mask.dtype != bool:
        raise PluginError(
            f"{member.title}: {method} returned shape {mask.shape} of {mask.dtype}, "
            f"expected ({count},) of bool, one entry per part"
        )
    return mask
