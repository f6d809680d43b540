"""Groups of unknowns that strong couplings join: which they are, and what it is worth to smooth by them."""

from __future__ import annotations

import numpy as np
import pytest
from flux_matrices import five_points
from scipy import sparse

from agglo_core.errors import OptionError
from agglo_core.multigrid import classical_stack, cycle, pcg
from agglo_core.multigrid.coarsening.strong_groups import group_smoother, strong_groups
from agglo_core.multigrid.matrices.checks import canonical

FRESH = 640219


def random_matrix(n: int, seed: int) -> sparse.csr_array:
    """Symmetric, positive definite, with couplings of both signs and of all strengths."""
    rng = np.random.default_rng(seed)
    dense = np.triu(10.0 ** rng.uniform(-3, 0, (n, n)) * (rng.random((n, n)) < 4.0 / n), 1)
    dense *= rng.choice([-1.0, 1.0], (n, n))
    dense += dense.T
    scale = 10.0 ** rng.uniform(-3, 3, n)
    full = dense + np.diag(np.abs(dense).sum(axis=1) + 1e-3)
    return canonical(sparse.csr_array(scale[:, None] * full * scale))


def groups_slowly(A: np.ndarray, most: int) -> list[set[int]]:
    """The groups, pair by pair."""
    n = len(A)
    groups = {i: {i} for i in range(n)}
    strength = np.abs(A) / np.sqrt(np.outer(A.diagonal(), A.diagonal()))
    pairs = [(strength[i, j], i, j) for i in range(n) for j in range(i + 1, n) if strength[i, j] >= 0.1]
    for _, i, j in sorted(pairs, key=lambda pair: (-pair[0], pair[1], pair[2])):
        if groups[i] is not groups[j] and len(groups[i]) + len(groups[j]) <= most:
            groups[i] |= groups[j]
            for k in groups[j]:
                groups[k] = groups[i]
    return sorted({min(each): each for each in groups.values()}.values(), key=min)


@pytest.mark.parametrize("most", [1, 3, 64])
def test_strongest_couplings_join_first(most: int) -> None:
    A = random_matrix(60, FRESH)
    found = strong_groups(A.tobsr((1, 1)), most)
    sets = [set(found.parts[a:b].tolist()) for a, b in zip(found.offsets, found.offsets[1:], strict=False)]
    assert sets == groups_slowly(A.toarray(), most), f"seed {FRESH}"


def test_a_group_of_all_is_solved() -> None:
    A = five_points(6, 1.0, 1.0)
    b = np.random.default_rng(FRESH).standard_normal(36)
    x, r = group_smoother(A, 36).before(b)
    assert A @ x == pytest.approx(b, abs=1e-3)
    assert r == pytest.approx(0.0, abs=1e-10)


def test_singular_groups_are_solved_as_far_as_they_can_be() -> None:
    A = canonical(sparse.csr_array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]))
    x, _ = group_smoother(A, 3).before(np.array([1.0, -1.0, 2.0]))
    assert x == pytest.approx([0.5, -0.5, 2.0], abs=1e-5)


def test_lines_make_up_for_coarse_unknowns_that_forget_a_direction() -> None:
    """With a guide that couples along y only, what varies along x is left to the smoother."""
    A, guide = five_points(24, 1.0, 0.02), five_points(24, 1e-4, 1.0)
    b = np.random.default_rng(FRESH).standard_normal(A.shape[0])
    counts = []
    for groups in (1, 24):
        stack = classical_stack(A, near_null=np.ones(len(b)), guide=guide, coarsest=20, groups=groups)
        counts.append(pcg(A, b, cycle(stack), tolerance=1e-8, stop="residual").iterations)
    assert counts[1] < 0.6 * counts[0]


def test_no_group_of_nothing() -> None:
    with pytest.raises(OptionError, match="must be 1 or more"):
        strong_groups(five_points(3, 1.0, 1.0).tobsr((1, 1)), 0)
