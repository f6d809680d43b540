"""Multigrid methods put together from parts: small exact cases, symmetry, counts, and what is refused."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import block_diag, eigvalsh

from agglo_core import (
    Component,
    Hierarchy,
    OptionError,
    PluginError,
    Registry,
    agglomerate,
    hookimpl,
    samples,
)
from agglo_core.multigrid import Composition, cycle, pcg, vertex_patches
from agglo_core.problems import Coarsening, CoarseSpace, MultigridLevel, System

Array = NDArray[np.float64]


def shifted(mesh, width: int = 1) -> System:
    """The shifted Laplacian of the dual graph, some unknowns in each cell."""
    links = mesh.graph.to_scipy()
    scalar = sparse.diags_array(links.sum(axis=1) + 0.01) - links
    A = sparse.csr_array(sparse.kron(scalar, 0.95 * np.eye(width) + 0.05))
    return System(A, np.ones(A.shape[0]), np.arange(mesh.n_cells + 1) * width, mesh)


@pytest.fixture(scope="module")
def voronoi() -> Hierarchy:
    """Two coarse levels."""
    return agglomerate(samples.voronoi(300, seed=8), n_parts=(60, 12))


def test_injection_and_galerkin_are_the_formulas() -> None:
    A = np.diag([2.0, 3.0, 4.0, 5.0]) - 0.5 * (np.eye(4, k=1) + np.eye(4, k=-1))
    stack = Composition("injection", "galerkin").stack(System(A, np.ones(4)), [np.array([0, 0, 1, 1])])
    P = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 1.0]])
    assert (stack.levels[0].P.toarray() == P).all()
    assert (stack.levels[1].A.toarray() == P.T @ A @ P).all()
    assert stack.coarse(np.array([1.0, 2.0])) == pytest.approx(np.linalg.solve(P.T @ A @ P, [1.0, 2.0]))


def test_smoothed_injection_is_one_damped_step_of_block_jacobi(voronoi: Hierarchy) -> None:
    system = shifted(voronoi.fine, 3)
    level = Composition("smoothed").stack(system, voronoi.levels[:1]).levels[0]
    A = system.A.toarray()
    inject = np.kron(np.eye(60)[voronoi.levels[0]], np.eye(3))
    blocks = [A[i : i + 3, i : i + 3] for i in range(0, len(A), 3)]
    D = block_diag(*map(np.linalg.inv, blocks))
    largest = eigvalsh(A, block_diag(*blocks), subset_by_index=[len(A) - 1] * 2)[0]
    step = inject - level.P.toarray()
    factor = float((step * (D @ A @ inject)).sum() / ((D @ A @ inject) ** 2).sum())
    assert step == pytest.approx(factor * (D @ A @ inject), abs=1e-12)
    assert factor == pytest.approx(4 / 3 / largest, rel=0.1)  # the eigenvalue is estimated


def test_aggregation_keeps_near_null_vectors_where_the_matrix_takes_them_to_zero(voronoi: Hierarchy) -> None:
    links = voronoi.graph.to_scipy()
    rigid = np.stack((np.ones(300), voronoi.graph.centroids[:, 0]), axis=1)
    A = sparse.diags_array(links.sum(axis=1)) - links
    stack = Composition("aggregation").stack(System(A, np.ones(300), near_null=rigid), voronoi.levels)
    sizes = [level.A.shape[0] for level in stack.levels]
    assert sizes == [300, int(stack.levels[1].block_offsets[-1]), int(stack.levels[2].block_offsets[-1])]
    assert 60 < sizes[1] <= 120
    P = stack.levels[0].P.toarray()
    left = rigid[:, 0] - P @ np.linalg.lstsq(P, rigid[:, 0], rcond=None)[0]
    assert np.abs(left).max() < 1e-10
    assert np.abs(stack.levels[1].A.toarray() @ np.linalg.lstsq(P, rigid[:, 0], rcond=None)[0]).max() < 1e-8


@pytest.mark.parametrize("transfer", ["injection", "smoothed", "aggregation"])
@pytest.mark.parametrize("smoother", ["gauss_seidel", "chebyshev", "block_jacobi", "vertex_patches"])
def test_every_composition_of_linear_parts_is_symmetric_and_converges(
    transfer: str, smoother: str, voronoi: Hierarchy
) -> None:
    system = shifted(voronoi.fine)
    stack = Composition(transfer, "galerkin", smoother).stack(system, voronoi.levels)
    for kind in ("V", "W"):
        M = cycle(stack, kind)  # type: ignore[arg-type]
        u, v = np.random.default_rng(0).standard_normal((2, system.n))
        assert u @ (M @ v) == pytest.approx(v @ (M @ u), rel=1e-9, abs=1e-9 * np.linalg.norm(M @ v))
    history = pcg(system.A, system.b, M, tolerance=1e-8)
    assert history.converged
    assert history.iterations <= 25


@pytest.mark.parametrize("coarse_solver", ["elimination", "dense", "lu"])
def test_coarse_solvers_solve(coarse_solver: str, voronoi: Hierarchy) -> None:
    stack = Composition(coarse_solver=coarse_solver).stack(shifted(voronoi.fine), voronoi.levels)
    A, b = stack.levels[-1].A.toarray(), np.arange(12.0)
    assert stack.coarse(b) == pytest.approx(np.linalg.solve(A, b))


class Watches:
    """Damped Jacobi that keeps the levels it is given."""

    def __init__(self) -> None:
        self.seen: list[MultigridLevel] = []

    def setup(self, level: MultigridLevel):
        self.seen.append(level)
        weights = 0.3 / level.A.diagonal()
        return lambda b, x: x + weights * (b - level.A @ x)


def test_a_strangers_smoother_gets_level_labels_patches_and_the_correction(voronoi: Hierarchy) -> None:
    mesh, own = voronoi.fine, Watches()
    system = shifted(mesh)
    Composition(smoother=own).stack(system, voronoi.levels, steps=3)
    assert [level.labels.tolist() for level in own.seen] == [list(range(300)), voronoi.levels[0].tolist()]
    for level, labels in zip(own.seen, (None, voronoi.levels[0]), strict=True):
        patches = vertex_patches(mesh, labels)
        assert level.patches.parts.tolist() == patches.parts.tolist()
        assert level.patches.offsets.tolist() == patches.offsets.tolist()
        assert level.steps == 3
        r = np.linspace(-1, 1, level.A.shape[0])
        B = (level.P.T @ level.A @ level.P).toarray()
        assert level.coarse(r) == pytest.approx(level.P @ np.linalg.solve(B, level.P.T @ r), rel=1e-8)
    Composition(smoother=own).stack(system, voronoi.levels, corrections=False)
    assert own.seen[-1].coarse is None
    bare = System(system.A, system.b)
    Composition(smoother=own).stack(bare, voronoi.levels)
    assert own.seen[-1].patches is None


class OneForEachPart:
    """The constants of the parts, whatever is in them."""

    def prolongation(self, step: Coarsening) -> CoarseSpace:
        part_of = np.repeat(step.parents, np.diff(step.block_offsets))
        P = sparse.csr_array((np.ones(len(part_of)), (np.arange(len(part_of)), part_of)))
        return CoarseSpace(P, np.arange(P.shape[1] + 1))


def test_parts_of_others_by_name_object_and_function(voronoi: Hierarchy) -> None:
    system, registry = shifted(voronoi.fine, 3), Registry()
    target = f"{__name__}:OneForEachPart"
    given = [Component("transfer", "ones", target)]
    registry.register(SimpleNamespace(agglo_components=hookimpl(lambda: given)), "mine")
    own = OneForEachPart()
    stacks = [
        Composition(each, registry=registry).stack(system, voronoi.levels)
        for each in ("ones", "mine/ones", own, own.prolongation)
    ]
    for stack in stacks:
        assert [level.A.shape[0] for level in stack.levels] == [900, 60, 12]
        assert abs(stack.levels[1].A - stacks[0].levels[1].A).max() == 0.0
    with pytest.raises(OptionError, match="one of injection, smoothed, aggregation, ones; given 'twos'"):
        Composition("twos", registry=registry)
    with pytest.raises(OptionError, match="transfer must be a name, an object with the method prolongation"):
        Composition(OneForEachPart)


def test_options_go_with_a_name() -> None:
    assert Composition(smoother=("chebyshev", {"degree": 4})).smoother.tool.degree == 4


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"transfer": lambda step: step.A.toarray()}, "prolongation returned .* expected a sparse matrix"),
        ({"transfer": lambda step: sparse.csr_array(np.eye(300, 7))}, "7 columns for 60 parts"),
        ({"transfer": lambda step: 1 / 0}, "ZeroDivisionError"),
        (
            {"transfer": lambda step: CoarseSpace(step.injected, np.arange(3))},
            "block_offsets must increase from 0 to 60",
        ),
        ({"coarse_operator": lambda step, P: step.A}, r"coarse_matrix returned \(300, 300\)"),
        ({"coarse_operator": lambda step, P: np.nan * (P.T @ P)}, "not finite"),
        ({"coarse_solver": lambda A: None}, "solver_for returned None, expected a function"),
        ({"smoother": lambda level: 3}, "setup returned 3, expected a function"),
    ],
)
def test_what_a_part_returns_is_checked(parts: dict[str, object], message: str, voronoi: Hierarchy) -> None:
    with pytest.raises(PluginError, match=message):
        Composition(**{"transfer": "injection", **parts}).stack(shifted(voronoi.fine), voronoi.levels)


def test_a_coarse_solver_that_returns_something_else_is_named(voronoi: Hierarchy) -> None:
    stack = Composition(coarse_solver=lambda A: lambda b: b[:2]).stack(shifted(voronoi.fine), voronoi.levels)
    with pytest.raises(PluginError, match=r"the solver returned shape \(2,\)"):
        cycle(stack) @ np.ones(300)


def test_parts_that_do_not_fit_together_are_refused(voronoi: Hierarchy) -> None:
    system = shifted(voronoi.fine)
    with pytest.raises(OptionError, match="use coarse_operator=galerkin"):
        Composition(coarse_operator="rediscretised").stack(system, voronoi.levels)
    crossed = [np.arange(300) % 20, np.arange(300) // 40]
    for transfer, message in (
        ("aggregation", "unions of agglomerates"),
        ("injection", "injection is not possible here"),
    ):
        with pytest.raises(OptionError, match=message):
            Composition(transfer).stack(system, crossed)
    uneven = System(system.A, system.b, np.r_[0, 1, np.arange(4, 301)])
    with pytest.raises(OptionError, match="unequal numbers of unknowns"):
        Composition("injection").stack(uneven, [np.arange(298) // 10])
    assert Composition("aggregation").stack(uneven, [np.arange(298) // 10]).levels[1].block_offsets[-1] >= 30
    with pytest.raises(OptionError, match=r"labels\[1\] must be 300 numbers, 0 or more"):
        Composition().stack(system, [voronoi.levels[0], np.arange(60) // 6])
    with pytest.raises(OptionError, match="injected must be given for each of 2 levels; given 1"):
        Composition().stack(system, voronoi.levels, injected=[None])
