"""Additive Schwarz beside its formula in dense algebra, and direct solution of singular matrices."""

from __future__ import annotations

import numpy as np
import pytest
from flux_matrices import iterations, truss, two_point_flux, two_valued
from scipy import sparse

from agglo_core import samples
from agglo_core.errors import OptionError
from agglo_core.multigrid import additive_schwarz, direct_solver


def boxes(mesh, per_side: int) -> np.ndarray:
    at = np.floor(mesh.cell_centroids * per_side).astype(int)
    return np.unique(at[:, 0] * per_side + at[:, 1], return_inverse=True)[1]


@pytest.mark.parametrize("overlap", [0, 1, 2])
def test_one_level_is_the_formula(overlap: int) -> None:
    mesh = samples.voronoi(120, seed=3)
    A, labels = two_point_flux(mesh, two_valued(120, 1)), boxes(mesh, 3)
    dense = A.toarray()
    expected = np.zeros((120, 120))
    for s in range(labels.max() + 1):
        inside = labels == s
        for _ in range(overlap):
            inside = (dense[:, inside] != 0.0).any(axis=1)
        rows = np.flatnonzero(inside)
        expected[np.ix_(rows, rows)] += np.linalg.inv(dense[np.ix_(rows, rows)])
    M = additive_schwarz(A, None, labels, overlap, coarse=False) @ np.eye(120)
    assert np.abs(M - expected).max() <= 1e-9 * np.abs(expected).max()


def test_blocks_and_both_levels_are_symmetric() -> None:
    A, motions = truss(400, seed=6)
    A = sparse.csr_array(A + 1e-4 * sparse.diags_array(A.diagonal()))
    labels = np.random.default_rng(0).integers(0, 7, 400)
    M = additive_schwarz(A, np.arange(0, 801, 2), labels, near_null=motions) @ np.eye(800)
    assert np.abs(M - M.T).max() <= 1e-9 * np.abs(M).max()
    assert np.linalg.eigvalsh(0.5 * (M + M.T)).min() > 0.0


def test_the_coarse_level_makes_counts_independent_of_subdomains() -> None:
    """Subdomains of 8 × 8 cells; twice as many each way."""
    used = {}
    for n in (48, 96):
        mesh = samples.squares(n)
        A, labels = two_point_flux(mesh, np.ones(n * n)), boxes(mesh, n // 8)
        for coarse in (False, True):
            used[coarse, n] = iterations(A, additive_schwarz(A, None, labels, coarse=coarse))
    assert used[True, 96] <= used[True, 48] + 5
    assert used[False, 96] >= 1.5 * used[False, 48]
    assert used[True, 96] <= 32


def test_one_subdomain_is_a_direct_solution() -> None:
    mesh = samples.squares(20)
    A = two_point_flux(mesh, np.ones(400))
    assert iterations(A, additive_schwarz(A, None, np.zeros(400, int), coarse=False)) <= 2


@pytest.mark.parametrize("dense", [0, 1000])
def test_direct_solution_of_singular_matrices(dense: int) -> None:
    mesh = samples.voronoi(500, seed=12)
    A = two_point_flux(mesh, two_valued(500, 3), dirichlet=False)
    b = np.random.default_rng(0).standard_normal(500)
    b -= b.mean()
    x = direct_solver(A, dense=dense)(b)
    assert np.linalg.norm(A @ x - b) <= 1e-6 * np.linalg.norm(b)


def test_what_does_not_fit_is_refused() -> None:
    A = sparse.eye_array(4, format="csr")
    with pytest.raises(OptionError, match="labels must be 4 numbers, 0 or more"):
        additive_schwarz(A, None, [0, 1, -1, 0])
    with pytest.raises(OptionError, match="overlap must be a number of layers, 0 or more; given -1"):
        additive_schwarz(A, None, [0, 1, 1, 0], overlap=-1)
    with pytest.raises(np.linalg.LinAlgError, match="-1 in row 0"):
        direct_solver(-A)
