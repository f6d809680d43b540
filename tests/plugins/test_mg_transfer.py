"""Levels that coarsen, injection and L2 projection between them."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from scipy import sparse

from agglo_core import Hierarchy, OptionError, samples
from agglo_core.multigrid import injection, parents
from agglo_core.solvers.fine_system import chosen_levels
from agglo_polydg_mg.auxiliary.box_transfer import project_between
from agglo_polydg_mg.auxiliary.transfer import diagonal_blocks, l2_projection
from agglo_polydg_mg.space.basis import Basis


def hierarchy_of(*levels: list[int]) -> Hierarchy:
    mesh = samples.squares(2)
    labels = [np.array(each) for each in levels]
    return Hierarchy(mesh, mesh.graph, labels, [{} for _ in labels], nested=False)


def test_levels_that_do_not_coarsen_are_skipped_with_a_notice(caplog: pytest.LogCaptureFixture) -> None:
    hierarchy = hierarchy_of([0, 1, 2, 3], [0, 0, 1, 1], [0, 1, 0, 1], [0, 0, 0, 0])
    with caplog.at_level(logging.INFO, "agglo"):
        chosen = chosen_levels(hierarchy)
    assert [each.tolist() for each in chosen] == [[0, 0, 1, 1], [0, 0, 0, 0]]
    assert [record.getMessage() for record in caplog.records] == [
        "level 0 is skipped: its 4 parts are not fewer than the 4 of the finer level",
        "level 2 is skipped: its 2 parts are not fewer than the 2 of the finer level",
    ]


def test_levels_count_the_mesh() -> None:
    hierarchy = hierarchy_of([0, 0, 1, 1], [0, 0, 0, 0])
    assert len(chosen_levels(hierarchy, 2)) == 1
    assert len(chosen_levels(hierarchy, 3)) == 2
    for levels in (1, 4):
        with pytest.raises(OptionError, match=rf"levels must lie in 2\.\.3.*given {levels}"):
            chosen_levels(hierarchy, levels)


def test_no_level_left_is_an_error() -> None:
    with pytest.raises(OptionError, match="no level of the hierarchy is coarser than its 4 cells"):
        chosen_levels(hierarchy_of([0, 1, 2, 3]))


def test_parents_exist_where_levels_nest() -> None:
    fine = np.array([0, 0, 1, 1, 2])
    nested = parents(fine, np.array([1, 1, 0, 0, 1]))
    assert nested is not None
    assert nested.tolist() == [1, 0, 1]
    assert parents(fine, np.array([0, 1, 1, 1, 1])) is None


def test_injection_repeats_the_unknowns_of_a_part() -> None:
    P = injection(np.array([1, 0, 1]), 2)
    assert (P @ np.array([1.0, 2.0, 3.0, 4.0])).tolist() == [3, 4, 1, 2, 3, 4]


def test_diagonal_blocks_are_those_of_the_dense_matrix() -> None:
    A = np.random.default_rng(0).random((6, 6))
    A[2:4, 2:4] = 0.0
    found = diagonal_blocks(sparse.csr_array(A), 2)
    assert np.array_equal(found, [A[i : i + 2, i : i + 2] for i in (0, 2, 4)])


@pytest.fixture(scope="module", params=[False, True], ids=["plain", "scaled"])
def spaces(request: pytest.FixtureRequest) -> tuple[Basis, Basis, Basis, np.ndarray, np.ndarray]:
    """Degree 2 on a Voronoi mesh and on two coarse levels that do not nest."""
    mesh = samples.voronoi(60, seed=1)
    x, y = mesh.cell_centroids.T
    fine = (x > 0.4) * 2 + (y > 0.6)
    coarse = (x + y > 1.1).astype(int)
    assert parents(fine, coarse) is None
    bases = [Basis(each, 2, request.param) for each in (mesh, mesh.coarsen(fine), mesh.coarsen(coarse))]
    return *bases, fine, coarse


def test_the_l2_projection_is_orthogonal(
    spaces: tuple[Basis, Basis, Basis, np.ndarray, np.ndarray],
) -> None:
    mesh, fine, coarse, fine_labels, coarse_labels = spaces
    down = [project_between(mesh, fine, fine_labels), project_between(mesh, coarse, coarse_labels)]
    P = l2_projection(*down, mesh.mass(), mesh.n_local)
    error = down[0].T @ mesh.mass() @ (down[0] @ P - down[1])
    assert P.shape == (fine.n, coarse.n)
    assert np.abs(error.toarray()).max() < 1e-12 * np.abs(P.toarray()).max()
    polynomial = [basis.project(lambda x: 1 + x[:, 0] * x[:, 1] - x[:, 1] ** 2) for basis in (fine, coarse)]
    assert P @ polynomial[1] == pytest.approx(polynomial[0], abs=1e-11)


def test_the_l2_projection_of_nested_levels_is_injection(
    spaces: tuple[Basis, Basis, Basis, np.ndarray, np.ndarray],
) -> None:
    mesh, fine, _, labels, _ = spaces
    whole = Basis(mesh.mesh.coarsen(np.zeros_like(labels)), 2, mesh.scaled)
    down = [project_between(mesh, fine, labels), project_between(mesh, whole, np.zeros_like(labels))]
    projected = l2_projection(*down, mesh.mass(), mesh.n_local)
    injected = project_between(fine, whole, np.zeros(4, int))
    assert projected.toarray() == pytest.approx(injected.toarray(), abs=1e-12)
