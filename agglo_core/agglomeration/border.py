"""Check the results of components, and name the component in error messages."""

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
    """Return the bisector adapted to this target, or ``member`` itself if the target changes nothing."""
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


def request_sides(member: Member, level: Graph, seeds: UInt64) -> Int:
    """Return each cell's side ``(n,)`` from the bisector, with probabilities rounded (1 iff p >= 0.5)."""
    with attributed(member.title):
        if callable(getattr(member.tool, "bisect_level", None)):
            returned = member.tool.bisect_level(level, seeds)
        else:
            returned = bisect_by_block(member.tool, level, seeds)
    return _as_sides(member, level, returned)


def sides_by_share(member: Member, level: Graph, seeds: UInt64, shares: Float | None) -> tuple[Int, Int]:
    """Return the sides ``(n,)``, and the blocks whose sides do not yet have the required mass shares.

    Blocks with a mass share below 1/2 are split by ``bisect_shares`` if the bisector has this method. Then
    only blocks with an empty side remain.
    """
    uneven = np.array([], np.int64) if shares is None else np.flatnonzero(shares < 0.5)
    if shares is None or len(uneven) == 0 or not member.offers("bisect_shares"):
        return request_sides(member, level, seeds), frozen_int(uneven)
    # 1. Bisect the blocks with equal shares.
    sides, even = np.empty(level.n, np.int64), np.flatnonzero(shares == 0.5)
    if len(even):
        sides[np.isin(level.block_ids, even)] = request_sides(member, level.take(even), seeds[even])
    # 2. Bisect the other blocks with their shares.
    part = level.take(uneven)
    with attributed(member.title):
        returned = member.tool.bisect_shares(part, seeds[uneven], frozen_float(shares[uneven]))
    found = _as_sides(member, part, returned)
    sides[np.isin(level.block_ids, uneven)] = found
    return frozen_int(sides), frozen_int(uneven[one_sided_blocks(part, found)])


def _as_sides(member: Member, level: Graph, returned: Any) -> Int:
    """Convert a bisector's result to sides 0 and 1, or raise PluginError if it is invalid.

    Probabilities are rounded.
    """
    with attributed(member.title):
        values = plain_array(returned, "the result of bisecting", PluginError)
    if values.shape != (level.n,):
        raise PluginError(f"{member.title} returned {_in_words(returned, values)}, expected ({level.n},)")
    if values.dtype.kind == "f":
        if not ((values >= 0) & (values <= 1)).all():
            raise PluginError(f"{member.title} returned probabilities that are NaN or outside [0, 1]")
        return frozen_int(values >= 0.5)
    if values.dtype.kind not in "iub":
        raise PluginError(f"{member.title} returned {values.dtype}, expected integers, booleans or floats")
    if values.min() < 0 or values.max() > 1:
        raise PluginError(f"{member.title} returned sides {values.min()}..{values.max()}, expected 0 and 1")
    return frozen_int(values)


def bisect_by_block(bisector: Bisector, level: Graph, seeds: UInt64) -> NDArray[Any]:
    """Bisect the blocks one after the other, each with its own random generator."""
    sides = []
    for b in range(level.n_blocks):
        piece = level[b]
        returned = bisector.bisect(piece, np.random.default_rng(int(seeds[b])))
        piece_sides = plain_array(returned, "the result of bisect", PluginError)
        if piece_sides.shape != (piece.n,):
            description = _in_words(returned, piece_sides)
            raise PluginError(f"bisect returned {description}, expected ({piece.n},): a side for each cell")
        sides.append(piece_sides)
    return np.concatenate(sides)


def check_parts(member: Member, given: Any, n: int, parts: int) -> Int:
    """Check the labels ``(n,)`` of a direct partition into at most ``parts`` parts, and close gaps."""
    labels = _integers(member, "partition", given, n)
    if labels.min() < 0 or labels.max() >= parts:
        raise PluginError(
            f"{member.title} returned labels {labels.min()}..{labels.max()}, but there are {parts} parts"
        )
    used = np.bincount(labels, minlength=parts) > 0
    return labels if used.all() else frozen_int((np.cumsum(used) - 1)[labels])


def check_split(member: Member, graph: Graph, pieces: Int, quotas: Int, given: Any, *, tested: bool) -> Int:
    """Check that the labels ``(n,)`` split each piece into as many parts as its quota, and return them.

    If ``tested``, the parts must be connected.
    """
    total = int(quotas.sum())
    labels, owner = _check_growth(member, graph, pieces, total, given, tested=tested)
    counts = np.bincount(owner[owner >= 0], minlength=len(quotas))
    if (counts != quotas).any():
        piece = int(np.flatnonzero(counts != quotas)[0])
        raise PluginError(
            f"{member.title} split piece {piece} into {counts[piece]} parts, expected {quotas[piece]}"
        )
    return labels


def check_split_to_size(member: Member, graph: Graph, pieces: Int, given: Any, *, tested: bool) -> Int:
    """Check that every part has cells and lies in one piece, and return the labels ``(n,)``.

    If ``tested``, the parts must be connected.
    """
    labels, owner = _check_growth(member, graph, pieces, graph.n, given, tested=tested)
    part_owners = owner[: int(labels.max()) + 1]
    if (part_owners < 0).any():
        raise PluginError(f"{member.title} left part {int(part_owners.argmin())} without cells")
    return labels


def check_widths(member: Member, labels: Int, wide: Mask, limit: float) -> int:
    """Count the parts marked in ``wide (k,)``, or raise PluginError if one of them has several cells."""
    if not wide.any():
        return 0
    if (wide & (np.bincount(labels, minlength=len(wide)) > 1)).any():
        raise PluginError(f"{member.title} grew a part wider than {limit:.6g}")
    return int(np.count_nonzero(wide))


def _check_growth(
    member: Member, graph: Graph, pieces: Int, total: int, returned: Any, *, tested: bool
) -> tuple[Int, Int]:
    """Check the labels of a recursive bisection, and return them with the piece of each part ``(total,)``.

    The piece of an unused label is −1.
    """
    labels = _integers(member, "grow", returned, graph.n)
    if labels.min() < 0 or labels.max() >= total:
        raise PluginError(
            f"{member.title} grew labels {labels.min()}..{labels.max()}, but there are {total} parts"
        )
    owner = np.full(total, -1, np.int64)
    if pieces.any():
        owner[labels] = pieces
        if (owner[labels] != pieces).any():
            raise PluginError(f"{member.title} grew a part that spans two pieces")
    else:  # one piece, the usual case: a connected mesh
        owner[labels] = 0
    if tested and len(broken_blocks(graph, labels)):
        raise PluginError(f"{member.title} left a part disconnected")
    return labels, frozen_int(owner)


def check_labels(member: Member, method: str, graph: Graph, before: Int, given: Any) -> Int:
    """Check that a component neither emptied nor created a part in any block, and return its labels."""
    after = _integers(member, method, given, graph.n)
    stride = int(before.max()) + 1
    if after.min() < 0 or after.max() >= stride:
        raise PluginError(
            f"{member.title} created labels {after.min()}..{after.max()} beyond 0..{stride - 1}"
        )
    if stride == 2 and not len(one_sided_blocks(graph, before)) and not len(one_sided_blocks(graph, after)):
        return after  # the usual case, and much cheaper than the general test
    # General test: compare the label sets of all blocks.
    had, has = _present(graph, before, stride), _present(graph, after, stride)
    if (had != has).any():
        block, part = np.argwhere(had != has)[0]
        verb = "emptied" if had[block, part] else "created"
        raise PluginError(f"{member.title} {verb} part {part} of block {block}")
    return after


def check_moves(member: Member, block: Int, before: Int, given: Any) -> Int:
    """Check labels from ``refine_parts``: no part is emptied, and no cell leaves its block."""
    after = _integers(member, "refine_parts", given, len(before))
    if after.min() < 0 or after.max() >= len(block):
        raise PluginError(
            f"{member.title} created labels {after.min()}..{after.max()} beyond 0..{len(block) - 1}"
        )
    has_cell = np.zeros(len(block), bool)
    has_cell[after] = True
    if not has_cell.all():
        raise PluginError(f"{member.title} emptied part {int(has_cell.argmin())}")
    moved = np.flatnonzero(after != before) if block.any() else frozen_int([])
    strays = moved[block[after[moved]] != block[before[moved]]]
    if len(strays):
        raise PluginError(f"{member.title} moved cell {strays[0]} to a part of another block")
    return after


def require_no_worse(member: Member, graph: Graph, before: Int, after: Int) -> None:
    """Raise PluginError if a refiner made its declared objective worse.

    Objectives that sum metric values need a mesh and are not checked here.
    """
    with attributed(member.title):
        name = getattr(member.tool, "objective", None)
    objective = OBJECTIVES.get(name) if isinstance(name, str) else None
    if objective is None:
        return
    increase = objective.worse_by(graph, before, after)
    if increase > 0.0:
        raise PluginError(
            f"{member.title} worsened its own objective: {objective.name} increased by "
            f"{increase:.6g}, from {objective.value(graph, before):.6g}"
        )


def _integers(member: Member, method: str, returned: Any, n: int) -> Int:
    """Return a component's result as ``(n,)`` integers, or raise PluginError if it is anything else."""
    with attributed(f"{member.title}: {method}"):
        labels = plain_array(returned, "the result", PluginError)
    if labels.shape != (n,) or labels.dtype.kind not in "iub":
        raise PluginError(
            f"{member.title}: {method} returned {_in_words(returned, labels)}, expected ({n},) integers"
        )
    return frozen_int(labels)


def _in_words(returned: Any, array: NDArray[Any]) -> str:
    return "None" if returned is None else f"shape {array.shape} of {array.dtype}"


def _present(graph: Graph, labels: Int, stride: int) -> Mask:
    """Return a mask ``(B, stride)`` of the labels 0..stride−1 that occur in each block."""
    room = graph.n_blocks * stride
    return (np.bincount(graph.block_ids * stride + labels, minlength=room) > 0).reshape(-1, stride)


def one_sided_blocks(level: Graph, sides: Int) -> Int:
    """Return the blocks whose cells are all on one side."""
    ones = np.add.reduceat(sides, level.offsets[:-1])
    return frozen_int(((ones == 0) | (ones == level.sizes)).nonzero()[0])


def broken_blocks(graph: Graph, labels: Int) -> Int:
    """Return the blocks with a disconnected part."""
    from agglo_core.compiled import graphs

    if graph.n_blocks == 1:
        return frozen_int([] if parts_connected(graph.indptr, graph.indices, labels) else [0])
    found = graphs.broken_blocks(graph.offsets, graph.indptr, graph.indices, frozen_int(labels))
    return frozen_int(np.flatnonzero(found))


def broken_halves(graph: Graph, sides: Int) -> Int:
    """Return the connected blocks with a disconnected side."""
    from agglo_core.agglomeration import halves

    return frozen_int(np.flatnonzero(halves.broken_halves(graph.offsets, graph.indptr, graph.indices, sides)))
