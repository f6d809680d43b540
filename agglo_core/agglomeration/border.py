"""Checks of whatever components return; errors name the component."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, Mask, UInt64, frozen_float, frozen_int, plain_array
from agglo_core.errors import PluginError
from agglo_core.graph import Graph
from agglo_core.graph.connection import parts_connected
from agglo_core.graph.objectives import OBJECTIVES
from agglo_core.protocols import Bisector, LevelBisector, Target
from agglo_core.registry.attribution import Member, attributed
from agglo_core.registry.containment import shown


def bisector_for(member: Member, target: Target) -> Member:
    """Return the bisector for this target: the same one if the target makes no difference to it."""
    if not callable(getattr(member.tool, "for_target", None)):
        return member
    with attributed(member.title):
        adapted = member.tool.for_target(target)
    if adapted is member.tool:
        return member
    if isinstance(adapted, type) or not isinstance(adapted, LevelBisector | Bisector):
        raise PluginError(
            f"{member.title}: for_target returned {shown(adapted)}, "
            "expected an object with bisect_level or bisect"
        )
    return Member(adapted, member.title)


def checked_sides(member: Member, level: Graph, seeds: UInt64) -> Int:
    """Sides ``(n,)`` in {0, 1} as returned by the bisector; probabilities are rounded (1 iff p >= 0.5)."""
    with attributed(member.title):
        if callable(getattr(member.tool, "bisect_level", None)):
            returned = member.tool.bisect_level(level, seeds)
        else:
            returned = bisect_by_block(member.tool, level, seeds)
    return _as_sides(member, level, returned)


def sides_by_share(member: Member, level: Graph, seeds: UInt64, shares: Float | None) -> tuple[Int, Int]:
    """Sides ``(n,)`` in {0, 1}, and the blocks whose cut is still to be moved to its share of the mass.

    Blocks with a share below 1/2 are split by ``bisect_shares`` if the bisector has it. Then only those with
    one empty side are left.
    """
    uneven = np.array([], np.int64) if shares is None else np.flatnonzero(shares < 0.5)
    if shares is None or len(uneven) == 0 or not member.offers("bisect_shares"):
        return checked_sides(member, level, seeds), frozen_int(uneven)
    sides, even = np.empty(level.n, np.int64), np.flatnonzero(shares == 0.5)
    if len(even):
        sides[np.isin(level.block_ids, even)] = checked_sides(member, level.take(even), seeds[even])
    part = level.take(uneven)
    with attributed(member.title):
        returned = member.tool.bisect_shares(part, seeds[uneven], frozen_float(shares[uneven]))
    found = _as_sides(member, part, returned)
    sides[np.isin(level.block_ids, uneven)] = found
    return frozen_int(sides), frozen_int(uneven[one_sided_blocks(part, found)])


def _as_sides(member: Member, level: Graph, returned: Any) -> Int:
    """Sides 0 and 1 of what a bisector returned, probabilities rounded; PluginError for anything else."""
    with attributed(member.title):
        given = plain_array(returned, "the result of bisecting", PluginError)
    if given.shape != (level.n,):
        raise PluginError(f"{member.title} returned {_in_words(returned, given)}, expected ({level.n},)")
    if given.dtype.kind == "f":
        if not ((given >= 0) & (given <= 1)).all():
            raise PluginError(f"{member.title} returned probabilities that are NaN or outside [0, 1]")
        return frozen_int(given >= 0.5)
    if given.dtype.kind not in "iub":
        raise PluginError(f"{member.title} returned {given.dtype}, expected integers, booleans or floats")
    if given.min() < 0 or given.max() > 1:
        raise PluginError(f"{member.title} returned sides {given.min()}..{given.max()}, expected 0 and 1")
    return frozen_int(given)


def bisect_by_block(bisector: Bisector, level: Graph, seeds: UInt64) -> NDArray[Any]:
    """Sides of all blocks from a bisector of single graphs: one call and one generator per block."""
    sides = []
    for b in range(level.n_blocks):
        piece = level[b]
        returned = bisector.bisect(piece, np.random.default_rng(int(seeds[b])))
        given = plain_array(returned, "the result of bisect", PluginError)
        if given.shape != (piece.n,):
            what = _in_words(returned, given)
            raise PluginError(f"bisect returned {what}, expected ({piece.n},): a side for each cell")
        sides.append(given)
    return np.concatenate(sides)


def checked_parts(member: Member, given: Any, n: int, parts: int) -> Int:
    """Labels ``(n,)`` of a direct partition into at most ``parts`` parts, gaps closed."""
    labels = _integers(member, "partition", given, n)
    if labels.min() < 0 or labels.max() >= parts:
        raise PluginError(f"{member.title} returned labels {labels.min()}..{labels.max()} for {parts} parts")
    return frozen_int(np.unique(labels, return_inverse=True)[1])


def checked_split(member: Member, graph: Graph, pieces: Int, quotas: Int, given: Any, *, tested: bool) -> Int:
    """Labels ``(n,)`` of a split of each piece into as many parts as its quota; connected, if ``tested``."""
    total = int(quotas.sum())
    labels, owner = _grown(member, graph, pieces, total, given, tested=tested)
    found = np.bincount(owner[owner >= 0], minlength=len(quotas))
    if (found != quotas).any():
        piece = int(np.flatnonzero(found != quotas)[0])
        raise PluginError(
            f"{member.title} split piece {piece} in {found[piece]}, expected {quotas[piece]} parts"
        )
    return labels


def checked_sizes(member: Member, graph: Graph, pieces: Int, given: Any, *, tested: bool) -> Int:
    """Labels ``(n,)`` of a split of the pieces into any number of parts, ``tested`` to be connected."""
    labels, owner = _grown(member, graph, pieces, graph.n, given, tested=tested)
    used = owner[: int(labels.max()) + 1]
    if (used < 0).any():
        raise PluginError(f"{member.title} left out part {int(used.argmin())}")
    return labels


def checked_widths(member: Member, labels: Int, wide: Mask, limit: float) -> int:
    """Count the single cells among the parts ``wide (k,)``; PluginError if one has several cells."""
    if not wide.any():
        return 0
    if (wide & (np.bincount(labels, minlength=len(wide)) > 1)).any():
        raise PluginError(f"{member.title} grew a part that is wider than {limit:.6g}")
    return int(np.count_nonzero(wide))


def _grown(
    member: Member, graph: Graph, pieces: Int, total: int, given: Any, *, tested: bool
) -> tuple[Int, Int]:
    """Labels of parts inside the pieces; the piece of each of ``total`` parts, −1 if unused."""
    labels = _integers(member, "grow", given, graph.n)
    if labels.min() < 0 or labels.max() >= total:
        raise PluginError(f"{member.title} grew labels {labels.min()}..{labels.max()} for {total} parts")
    owner = np.full(total, -1, np.int64)
    if pieces.any():
        owner[labels] = pieces
        if (owner[labels] != pieces).any():
            raise PluginError(f"{member.title} grew a part that lies in two pieces")
    else:  # one piece: a connected mesh, most of the time
        owner[labels] = 0
    if tested and len(broken_blocks(graph, labels)):
        raise PluginError(f"{member.title} left a part disconnected")
    return labels, frozen_int(owner)


def checked_labels(member: Member, method: str, graph: Graph, before: Int, given: Any) -> Int:
    """The labels ``given`` by a method of a component; each block must have the labels it had ``before``."""
    after = _integers(member, method, given, graph.n)
    stride = int(before.max()) + 1
    if after.min() < 0 or after.max() >= stride:
        raise PluginError(
            f"{member.title} created labels {after.min()}..{after.max()} beyond 0..{stride - 1}"
        )
    if stride == 2 and not len(one_sided_blocks(graph, before)) and not len(one_sided_blocks(graph, after)):
        return after  # nearly always, and at a fraction of what follows
    had, has = _present(graph, before, stride), _present(graph, after, stride)
    if (had != has).any():
        block, part = np.argwhere(had != has)[0]
        verb = "emptied" if had[block, part] else "created"
        raise PluginError(f"{member.title} {verb} part {part} of block {block}")
    return after


def checked_moves(member: Member, block: Int, before: Int, given: Any) -> Int:
    """The labels ``given`` by ``refine_parts``: no part is emptied, no cell leaves its block."""
    after = _integers(member, "refine_parts", given, len(before))
    if after.min() < 0 or after.max() >= len(block):
        raise PluginError(
            f"{member.title} created labels {after.min()}..{after.max()} beyond 0..{len(block) - 1}"
        )
    used = np.zeros(len(block), bool)
    used[after] = True
    if not used.all():
        raise PluginError(f"{member.title} emptied part {int(used.argmin())}")
    moved = np.flatnonzero(after != before) if block.any() else frozen_int([])
    left = moved[block[after[moved]] != block[before[moved]]]
    if len(left):
        raise PluginError(f"{member.title} moved cell {left[0]} to a part of another block")
    return after


def require_no_worse(member: Member, graph: Graph, before: Int, after: Int) -> None:
    """Raise PluginError if a refiner made the objective it names worse.

    The sum of a metric's values needs a mesh, which is not to be had here: there the refiner is believed.
    """
    with attributed(member.title):
        name = getattr(member.tool, "objective", None)
    objective = OBJECTIVES.get(name) if isinstance(name, str) else None
    if objective is None:
        return
    grown = objective.worse_by(graph, before, after)
    if grown > 0.0:
        raise PluginError(
            f"{member.title} made its own objective worse: {objective.name} grew by {grown:.6g}, "
            f"from {objective.value(graph, before):.6g}"
        )


def _integers(member: Member, method: str, given: Any, n: int) -> Int:
    """Integers ``(n,)`` that a component returned; PluginError for anything else."""
    with attributed(f"{member.title}: {method}"):
        labels = plain_array(given, "the result", PluginError)
    if labels.shape != (n,) or labels.dtype.kind not in "iub":
        raise PluginError(
            f"{member.title}: {method} returned {_in_words(given, labels)}, expected ({n},) integers"
        )
    return frozen_int(labels)


def _in_words(returned: Any, array: NDArray[Any]) -> str:
    return "None" if returned is None else f"shape {array.shape} of {array.dtype}"


def _present(graph: Graph, labels: Int, stride: int) -> Mask:
    """Mask ``(B, stride)`` of the labels 0..stride−1 that occur in each block."""
    room = graph.n_blocks * stride
    return (np.bincount(graph.block_ids * stride + labels, minlength=room) > 0).reshape(-1, stride)


def one_sided_blocks(level: Graph, sides: Int) -> Int:
    """Blocks whose cells are all on one side."""
    ones = np.add.reduceat(sides, level.offsets[:-1])
    return frozen_int(((ones == 0) | (ones == level.sizes)).nonzero()[0])


def broken_blocks(graph: Graph, labels: Int) -> Int:
    """Blocks with a part that is not connected."""
    from agglo_core.compiled import graphs

    if graph.n_blocks == 1:
        return frozen_int([] if parts_connected(graph.indptr, graph.indices, labels) else [0])
    found = graphs.broken_blocks(graph.offsets, graph.indptr, graph.indices, frozen_int(labels))
    return frozen_int(np.flatnonzero(found))


def broken_halves(graph: Graph, sides: Int) -> Int:
    """Blocks with a side that is not connected, the blocks themselves being connected."""
    from agglo_core.agglomeration import halves

    return frozen_int(np.flatnonzero(halves.broken_halves(graph.offsets, graph.indptr, graph.indices, sides)))
