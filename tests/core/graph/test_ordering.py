"""The Hilbert curve against Skilling's algorithm, and a frame that moves with the points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from agglo_core.graph.frame import moving_frame
from agglo_core.graph.ordering import curve_order

SEEDS = st.integers(0, 10**6)


def slow_hilbert(steps: list[int], bits: int) -> int:
    """Index of a lattice point along the curve (Skilling, 2004), bit by bit."""
    x, d = list(steps), len(steps)
    for power in range(bits - 1, 0, -1):
        step = 1 << power
        for a in range(d):
            if x[a] & step:
                x[0] ^= step - 1
            else:
                mixed = (x[0] ^ x[a]) & (step - 1)
                x[0], x[a] = x[0] ^ mixed, x[a] ^ mixed
    for a in range(1, d):
        x[a] ^= x[a - 1]
    flips = 0
    for power in range(bits - 1, 0, -1):
        if x[-1] & (1 << power):
            flips ^= (1 << power) - 1
    return sum(((x[a] ^ flips) >> b & 1) << (d * b + d - 1 - a) for a in range(d) for b in range(bits))


@settings(max_examples=30, deadline=None)
@given(SEEDS, st.sampled_from([2, 3]), st.booleans())
def test_points_are_sorted_along_the_hilbert_curve(seed: int, dim: int, turned: bool) -> None:
    rng = np.random.default_rng(seed)
    points, axes = rng.random((40, dim)) * 3.0 - 1.0, np.eye(dim)
    if turned:
        axes = np.linalg.qr(rng.normal(size=(dim, dim)))[0]
    bits, local = {2: 18, 3: 14}[dim], points @ axes.T
    extent = float(np.ptp(local, axis=0).max())
    steps = ((local - local.min(axis=0)) * ((2**bits - 1) / extent) + 1 / np.pi).astype(int)
    wanted = sorted(range(40), key=lambda i: (slow_hilbert(steps[i].tolist(), bits), i))
    assert curve_order(points, axes).tolist() == wanted


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("step", [0.0, 1e-7])
def test_points_in_one_step_are_sorted_along_the_first_axis(dim: int, step: float) -> None:
    """Also with so many in a step that the bucket sort is not used."""
    rng = np.random.default_rng(dim)
    for n in (5, 3000):
        points = np.concatenate((step * rng.random((n, dim)), np.ones((1, dim))))
        order = curve_order(points)
        assert order[-1] == n
        assert (np.diff(points[order, 0]) >= 0.0).all()
        shuffle = rng.permutation(n + 1)
        np.testing.assert_array_equal(points[shuffle][curve_order(points[shuffle])], points[order])


@pytest.mark.parametrize("dim", [2, 3])
def test_the_curve_visits_neighbours_of_a_lattice_one_after_the_other(dim: int) -> None:
    lattice = np.stack(np.meshgrid(*[np.arange(16.0)] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    path = lattice[curve_order(lattice)]
    np.testing.assert_array_equal(np.abs(np.diff(path, axis=0)).sum(axis=1), 1.0)


@settings(max_examples=30, deadline=None)
@given(SEEDS, st.sampled_from([2, 3]), st.booleans())
def test_the_frame_moves_with_the_points(seed: int, dim: int, stretched: bool) -> None:
    """Also where second moments are nearly equal, as on a square or cube."""
    rng = np.random.default_rng(seed)
    points, weights = rng.random((500, dim)), rng.random(500)
    if stretched:
        points *= [3.0, 1.0, 0.4][:dim]
    frame = moving_frame(points, weights)
    np.testing.assert_allclose(frame @ frame.T, np.eye(dim), atol=1e-12)
    turn = np.linalg.qr(rng.normal(size=(dim, dim)))[0]
    np.testing.assert_allclose(moving_frame(7.0 * points @ turn.T + 3.0, weights) @ turn, frame, atol=1e-8)
    shuffle = rng.permutation(500)
    np.testing.assert_allclose(moving_frame(points[shuffle], weights[shuffle]), frame, atol=1e-8)


def test_the_frame_of_a_square_lies_along_its_sides() -> None:
    lattice = np.stack(np.meshgrid(np.arange(9.0), np.arange(9.0)), axis=-1).reshape(-1, 2)
    angle = 0.4
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    across = np.abs(moving_frame(lattice @ turn.T, np.ones(81)) @ turn)
    np.testing.assert_allclose(np.sort(across, axis=None), [0.0, 0.0, 1.0, 1.0], atol=1e-12)


@pytest.mark.parametrize("weights", [np.zeros(4), np.ones(4)])
def test_a_frame_exists_without_extent_or_weight(weights: np.ndarray) -> None:
    frame = moving_frame(np.ones((4, 3)), weights)
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
