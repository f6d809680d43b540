"""What a run across ranks sends, told level by level."""

from __future__ import annotations

import pytest
from on_ranks import on_ranks

import agglo_core as agglo
from agglo_core.distributed import DistributedMesh, Ranks, agglomerate


def sent_for_three_levels() -> tuple[list[dict[str, int]], int, int]:
    """By level, and in all, on this rank; the coarser levels are made on one rank."""
    ranks = Ranks()
    mesh = DistributedMesh.scatter(agglo.samples.squares(24) if ranks.rank == 0 else None, ranks)
    straight = agglo.Pipeline(n_parts=(72, 12, 3), bisector="coordinate", refiners=(), polish=False)
    told = agglomerate(mesh, straight).statistics
    return told["sent_by_level"], told["messages"], told["bytes"]


def test_levels_on_fewer_ranks_are_those_that_send_graphs() -> None:
    every = on_ranks(2, sent_for_three_levels)
    for levels, messages, sent in every:
        assert len(levels) == 3
        assert 0 < sum(each["messages"] for each in levels) <= messages
        assert 0 < sum(each["bytes"] for each in levels) <= sent
    giver = every[1][0]  # its part of the graph goes to rank 0, with the first level made there
    assert giver[1]["bytes"] > max(giver[0]["bytes"], giver[2]["bytes"])


def test_one_rank_sends_nothing() -> None:
    pytest.importorskip("mpi4py")
    assert sent_for_three_levels() == ([{"messages": 0, "bytes": 0}] * 3, 0, 0)
