"""Parts of a block in strips: those of a slice as before, near one another, however the block is turned."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from agglo_core.arrays import frozen_int
from agglo_core.refine.compactness import strips as part_strips
from agglo_core.refine.compactness.part_order import places_across
from agglo_core.refine.compactness.state import CENTRE, MASS
from agglo_core.refine.compactness.strips import slices, strip_order

SEEDS = st.integers(0, 10**6)


def blocks(seed: int, dim: int, sizes: tuple[int, ...]):
    """Masses, centres, and blocks of parts in a random order; an axis of each block."""
    rng = np.random.default_rng(seed)
    k = sum(sizes)
    block = frozen_int(rng.permutation(np.repeat(np.arange(len(sizes)), sizes)))
    centres, axes = np.zeros((k, 3)), np.zeros((len(sizes), 3))
    centres[:, :dim] = rng.random((k, dim)) ** 2
    axes[:, :dim] = rng.normal(size=(len(sizes), dim))
    return rng.random(k) + 0.1, centres, block, axes


def tally_of(mass, centres):
    tally = np.zeros((len(mass), 8))
    tally[:, MASS], tally[:, CENTRE : CENTRE + 3] = mass, centres
    return tally


def order_of(mass, centres, block, axes, dim):
    return strip_order(tally_of(mass, centres), block, axes, (centres * axes[block]).sum(axis=1), dim)


@settings(max_examples=20, deadline=None)
@given(SEEDS, st.sampled_from([2, 3]))
def test_places_across_are_along_the_moments_with_the_axis(seed: int, dim: int) -> None:
    mass, centres, block, axes = blocks(seed, dim, (30, 3, 50))
    found = places_across(block, tally_of(mass, centres), axes, dim)
    for b, axis in enumerate(axes):
        own = block == b
        local = centres[own] - np.average(centres[own], axis=0, weights=mass[own])
        unit = axis / np.linalg.norm(axis)
        moments = np.average(local * (local @ unit)[:, None], axis=0, weights=mass[own])
        np.testing.assert_allclose(found[own], local @ (moments - (moments @ unit) * unit), atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(SEEDS, st.sampled_from([2, 3]))
def test_slices_hold_the_parts_they_hold_along_the_axis(seed: int, dim: int) -> None:
    mass, centres, block, axes = blocks(seed, dim, (500, 3, 900))
    starts = frozen_int([0, 500, 503, 1403])
    plain = np.lexsort(((centres * axes[block]).sum(axis=1), block))
    with pytest.MonkeyPatch.context() as patch:
        np.testing.assert_array_equal(order_of(mass, centres, block, axes, dim), plain)  # too few for strips
        patch.setattr(part_strips, "_MANY", 0)
        patch.setattr(part_strips, "_WIDTH", 2.0)
        order = order_of(mass, centres, block, axes, dim)
        rows = np.concatenate([slices(starts, shift, dim) for shift in range(2)])
    assert (order != plain).any()
    assert len(rows) > 10
    for lo, hi in rows[:, :2]:
        assert set(order[lo:hi]) == set(plain[lo:hi])


def test_strips_run_across_the_axis() -> None:
    mass, centres, block, axes = blocks(1, 2, (2_000,))
    axis = axes[0, :2] / np.linalg.norm(axes[0, :2])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(part_strips, "_MANY", 0)
        order = order_of(mass, centres, block, axes, 2)
        starts = slices(frozen_int([0, 2_000]), 0, 2)[:, 0]
    across = centres[order, :2] @ (-axis[1], axis[0])
    steps = np.diff(across[: starts[1] // 2])
    assert (steps > 0).all() or (steps < 0).all()


@settings(max_examples=20, deadline=None)
@given(SEEDS, st.sampled_from([2, 3]))
def test_strips_move_with_the_block(seed: int, dim: int) -> None:
    mass, centres, block, axes = blocks(seed, dim, (700, 400))
    rng = np.random.default_rng(seed)
    turn = np.eye(3)
    turn[:dim, :dim] = np.linalg.qr(rng.normal(size=(dim, dim)))[0]  # half of them are mirrors
    number = rng.permutation(len(block))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(part_strips, "_MANY", 0)
        patch.setattr(part_strips, "_WIDTH", 3.0)
        order = order_of(mass, centres, block, axes, dim)
        moved = order_of(
            mass[number], (centres @ turn.T + turn[0])[number], frozen_int(block[number]), axes @ turn.T, dim
        )
    np.testing.assert_array_equal(number[moved], order)


@pytest.mark.parametrize("dim", [2, 3])
def test_symmetry_and_parts_in_one_place_are_no_harm(dim: int) -> None:
    centres = np.zeros((800, 3))
    centres[:, :dim] = np.random.default_rng(0).choice([-1.0, 0.0, 1.0], (800, dim))
    block, axes = frozen_int(np.zeros(800)), np.eye(3)[:1]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(part_strips, "_MANY", 0)
        for mass in (np.ones(800), np.zeros(800)):
            assert sorted(order_of(mass, centres, block, axes, dim)) == list(range(800))
