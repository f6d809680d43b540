"""Systems in which springs join some unknowns stiffly, with and without loads across them."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from flux_matrices import two_point_flux
from scipy import sparse
from scipy.sparse.linalg import spsolve

from agglo_core import Hierarchy, agglomerate, samples
from agglo_core.problems import Linear
from agglo_core.problems.residuals.row_scales import lifted, row_sizes
from agglo_core.problems.residuals.stiff_springs import imposed_differences, stiffest_joint
from agglo_core.registry import default

MESH = samples.squares(20)
N = MESH.n_cells
SOLVERS = {"polydg_mg": {}, "polydg_cg": {}, "direct": {"backend": "superlu"}}
GROUPS = {"pair": [(0, 1)], "chain": [(0, 1), (1, 2)], "star": [(0, 1), (0, 2), (0, 3), (0, 4)]}


@cache
def levels() -> Hierarchy:
    """Return the agglomerates. At import each worker would wait for their kernels."""
    return agglomerate(MESH, cells_per_part=(8, 64))


def laplacian() -> sparse.csr_array:
    side = sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(20, 20))
    one = sparse.eye_array(20)
    return sparse.csr_array(sparse.kron(side, one) + sparse.kron(one, side))


def sprung(kind: str, stiffness: float, jump: float) -> tuple[sparse.csr_array, np.ndarray, np.ndarray]:
    """Matrix, load and solution; that is known from unknowns of each group and differences along springs.

    With x = T z the springs are a diagonal, and z = jump + y: y solves a system of unit diagonal.
    """
    parent = np.full(N, -1)
    for first in np.arange(5, N - 120, 13)[:20]:
        for i, j in GROUPS[kind]:
            parent[first + 29 * j] = first + 29 * i
    child = np.flatnonzero(parent >= 0)
    T = sparse.eye_array(N, format="csr")
    up = sparse.csr_array((np.ones(len(child)), (child, parent[child])), shape=(N, N))
    for _ in range(3):
        T = sparse.csr_array(sparse.eye_array(N) + up @ T)
    A, load = laplacian(), (1.0 + np.arange(N) / N) / 400.0
    springs = sparse.diags_array(np.where(parent >= 0, stiffness, 0.0))
    differences = sparse.csr_array(sparse.eye_array(N) - up)
    full = sparse.csr_array(A + differences.T @ springs @ differences)
    imposed = np.where(parent >= 0, jump, 0.0)
    B = T.T @ A @ T + springs
    d = 1.0 / np.sqrt(B.diagonal())
    D = sparse.diags_array(d)
    y = spsolve(sparse.csc_array(D @ B @ D), d * (T.T @ (load - A @ (T @ imposed))))
    return full, load + differences.T @ (springs @ imposed), T @ (imposed + d * y)


@pytest.mark.parametrize("jump", [0.0, 0.5])
@pytest.mark.parametrize("stiffness", [1e4, 1e8, 1e11, 1e14])
@pytest.mark.parametrize("kind", GROUPS)
def test_what_is_called_converged_is_right(kind: str, stiffness: float, jump: float) -> None:
    A, b, exact = sprung(kind, stiffness, jump)
    for name, more in SOLVERS.items():
        it = default().build("solver", name, **more).solve(Linear(A, b, np.arange(N + 1)), levels())
        if it.converged:
            assert np.abs(it.x - exact).max() <= 1e-5 * np.abs(exact).max()
        elif stiffness >= 1e10:
            assert "coupled so strongly" in it.reason
        assert it.converged or stiffness >= 1e10 or name == "polydg_cg"
        assert not it.converged or stiffness <= 1e12


@pytest.mark.parametrize("sign", ["flipped", "scaled"])
def test_signs_and_units_of_unknowns_do_not_hide_springs(sign: str) -> None:
    units = np.where(np.arange(N) % 3 == 0, -1.0, 1.0) if sign == "flipped" else 2.0 ** (np.arange(N) % 4)
    D = sparse.diags_array(units)
    for stiffness in (1e6, 1e12):
        A, b, exact = sprung("pair", stiffness, 0.5)
        problem = Linear(D @ A @ D, units * b, np.arange(N + 1))
        for name in ("polydg_mg", "direct"):
            it = default().build("solver", name, **SOLVERS[name]).solve(problem, levels())
            if it.converged:
                assert np.abs(it.x * units - exact).max() <= 1e-5 * np.abs(exact).max()
            assert stiffness == 1e6 or not it.converged


def test_loads_across_springs_are_taken_out() -> None:
    A, b, exact = sprung("chain", 1e8, 0.5)
    B = np.stack([b, laplacian() @ np.ones(N), np.zeros(N), -2.0 * b], axis=1)
    offset, load = lifted(A, B)
    assert np.count_nonzero(offset[:, 0]) == np.count_nonzero(offset[:, 3]) == 40
    assert not offset[:, 1:3].any()
    assert np.array_equal(load[:, 1:3], B[:, 1:3])
    assert np.abs(load[:, 0]).max() < 10.0 < 1e7 < np.abs(b).max()
    assert np.abs(A @ offset + load - B).max() <= 1e-7  # rounding of entries of 1e8
    assert np.abs(offset[:, 0]).max() == pytest.approx(0.5, rel=1e-6)  # from the middle of each chain
    assert np.allclose(load[:, 3], -2.0 * load[:, 0])
    ends = np.flatnonzero(offset[:, 0])
    assert np.allclose(np.abs(exact[ends] - exact[ends - 29 * np.sign(offset[ends, 0]).astype(int)]), 0.5)


def test_ordinary_systems_are_left_alone() -> None:
    """Loads of one sign, at random, and of Dirichlet values, beside contrasts and stretched cells."""
    random = np.random.default_rng(1)
    side = sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(20, 20))
    one = sparse.eye_array(20)
    stretched = sparse.csr_array(sparse.kron(side, one) + 1e-6 * sparse.kron(one, side))
    inside = (np.abs(MESH.cell_centroids - 0.5) < 0.25).all(axis=1)
    island = two_point_flux(MESH, np.where(inside, 1e8, 1.0))
    scattered = two_point_flux(MESH, np.where(random.random(N) < 0.3, 1e8, 1.0))
    for A in (laplacian(), stretched, island, scattered):
        edge = np.where(MESH.cell_centroids[:, 0] < 0.05, 1.0, 0.0)
        for b in (np.ones(N), random.standard_normal(N), A.diagonal() * edge):
            assert imposed_differences(A, b, row_sizes(A)) is None
        it = default().build("solver", "polydg_mg").solve(Linear(A, np.ones(N), np.arange(N + 1)), levels())
        assert it.converged
        assert np.abs(it.x - spsolve(A.tocsc(), np.ones(N))).max() <= 1e-5 * np.abs(it.x).max()


def test_the_stiffest_joint_is_named() -> None:
    A, _, _ = sprung("pair", 1e10, 0.0)
    assert stiffest_joint(A) == (5, 34)
    assert stiffest_joint(laplacian()) is None
    assert stiffest_joint(sprung("pair", 1e6, 0.0)[0]) is None
