"""The tests' own way of running functions on several ranks: answers, failures, ranks that hang."""

from __future__ import annotations

import pytest
from on_ranks import on_ranks


def where(text: str) -> tuple[int, int, str]:
    from mpi4py import MPI

    return MPI.COMM_WORLD.rank, MPI.COMM_WORLD.size, text


def fails_on_one() -> None:
    from agglo_core.distributed import Ranks

    ranks = Ranks()
    with ranks.together():
        if ranks.rank == 1:
            raise ValueError("so it goes")


def hangs_on_one() -> None:
    from mpi4py import MPI

    if MPI.COMM_WORLD.rank == 0:
        MPI.COMM_WORLD.Barrier()


@pytest.mark.parametrize("size", [1, 3])
def test_answers_come_in_the_order_of_the_ranks(size: int) -> None:
    assert on_ranks(size, where, "here") == [(rank, size, "here") for rank in range(size)]


def test_the_error_of_the_rank_that_failed_is_shown_first() -> None:
    with pytest.raises(AssertionError, match=r"(?s)failure-1:.*ValueError: so it goes.*RankError: rank 1"):
        on_ranks(2, fails_on_one)


def test_ranks_that_wait_for_ever_are_shown_where_they_stand() -> None:
    with pytest.raises(AssertionError, match="in hangs_on_one"):
        on_ranks(2, hangs_on_one, seconds=1.0)
