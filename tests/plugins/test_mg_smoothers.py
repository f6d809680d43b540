"""Smoothers of the paper's cycle: by name, as objects, and what a third-party one is given."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import spsolve

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
from agglo_core.multigrid import BlockJacobi
from agglo_core.problems import Diffusion, Linear, MultigridLevel
from agglo_core.protocols import Smoother
from agglo_polydg_mg.paper.paper_multigrid import PaperMultigrid
from agglo_polydg_mg.paper.schwarz import Schwarz, smoother_of

Array = NDArray[np.float64]


class PointJacobi:
    """Damped Jacobi on single unknowns."""

    def __init__(self) -> None:
        self.seen: list[MultigridLevel] = []

    def setup(self, level: MultigridLevel) -> Callable[[Array, Array], Array]:
        """Keep the level, and damp by a bound of the spectrum."""
        self.seen.append(level)
        diagonal = level.A.diagonal()
        scaled = abs(sparse.diags_array(1 / diagonal) @ sparse.csr_array(level.A))
        damping = 1.0 / float(scaled.sum(axis=1).max())

        def smooth(b: Array, x: Array) -> Array:
            for _ in range(level.steps):
                x = x + damping * (b - level.A @ x) / diagonal
            return x

        return smooth


@pytest.fixture(scope="module")
def squares() -> Hierarchy:
    """Two coarse levels."""
    return agglomerate(samples.squares(8), n_parts=(16, 4))


@pytest.mark.parametrize("operators", ["rediscretised", "inherited"])
@pytest.mark.parametrize("schwarz_coarse", [True, False])
def test_a_strangers_smoother_converges_and_sees_the_level(
    operators: str, schwarz_coarse: bool, squares: Hierarchy
) -> None:
    own = PointJacobi()
    solver = PaperMultigrid(
        smoother=own, operators=operators, schwarz_coarse=schwarz_coarse, smoothing_steps=4, tolerance=1e-8
    )
    solution = solver.solve(Diffusion(), squares)
    assert solution.converged
    direct = spsolve(sparse.csc_array(solution.A), solution.b)
    assert np.linalg.norm(solution.x - direct) < 1e-5 * np.linalg.norm(direct)
    sizes = [(3 * 64, 3 * 16), (3 * 16, 3 * 4)]
    assert [level.P.shape for level in own.seen] == sizes
    for level, (n, below), labels in zip(own.seen, sizes, (np.arange(64), squares.levels[0]), strict=True):
        assert level.A.shape == level.inherited.shape == (n, n)
        assert level.block_offsets.tolist() == list(range(0, n + 1, 3))
        assert level.labels.tolist() == labels.tolist()
        assert level.steps == 4
        assert level.patches is not None
        assert np.unique(level.patches.parts).tolist() == list(range(n // 3))
        assert (level.coarse is not None) is schwarz_coarse
        if level.coarse is not None:
            r = np.linspace(-1, 1, n)
            B = (level.P.T @ level.inherited @ level.P).toarray()
            assert B.shape == (below, below)
            assert level.coarse(r) == pytest.approx(level.P @ np.linalg.solve(B, level.P.T @ r), rel=1e-8)
    gap = abs(own.seen[1].A - own.seen[1].inherited).max()
    assert bool(gap < 1e-12) is (operators == "inherited")


def test_a_strangers_smoother_has_the_levels_of_a_linear_system(squares: Hierarchy) -> None:
    own, n = PointJacobi(), squares.graph.n
    A = squares.graph.to_scipy()
    A = sparse.diags_array(A.sum(axis=1) + 0.1) - A
    problem = Linear(sparse.csr_array(A), np.ones(n), np.arange(n + 1))
    assert PaperMultigrid(smoother=own).solve(problem, squares).converged
    assert [level.A.shape[0] for level in own.seen] == [64, 16]


def test_names_and_objects_are_the_same_smoother(squares: Hierarchy) -> None:
    def solved(smoother: object) -> Array:
        return PaperMultigrid(smoother=smoother).solve(Diffusion(), squares).x

    assert (solved("schwarz") == solved(Schwarz())).all()
    assert (solved("block_jacobi") == solved(BlockJacobi())).all()
    assert not (solved("schwarz") == solved("block_jacobi")).all()


def test_names_are_looked_up_in_the_registry() -> None:
    registry = Registry()
    given = [
        Component("smoother", name, f"{PointJacobi.__module__}:PointJacobi") for name in ("points", "dots")
    ]
    registry.register(SimpleNamespace(agglo_components=hookimpl(lambda: given)), "mine")
    assert isinstance(smoother_of("schwarz", registry).tool, Schwarz)
    assert isinstance(smoother_of("points", registry).tool, PointJacobi)
    assert isinstance(smoother_of("mine/dots", registry).tool, PointJacobi)
    with pytest.raises(
        OptionError, match="one of schwarz, block_jacobi, chebyshev, gauss_seidel, dots, points; given 'sor'"
    ):
        smoother_of("sor", registry)
    registry.block("mine")
    with pytest.raises(PluginError, match="blocked"):
        smoother_of("points", registry)


@pytest.mark.parametrize("smoother", [Schwarz(), BlockJacobi()])
def test_smoothers_keep_to_the_protocol_and_pickle(smoother: Smoother) -> None:
    assert isinstance(smoother, Smoother)
    assert type(pickle.loads(pickle.dumps(smoother))) is type(smoother)
