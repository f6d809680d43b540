"""Nonlinear problems by Newton's method, and implicit reactions in time steps."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import agglo_core as agglo
from agglo_core import Diffusion, OptionError, samples
from agglo_core.arrays import Float

MESH = samples.voronoi(300, seed=1)


def exact(x: Float) -> Float:
    return 2.0 * np.sin(np.pi * x).prod(axis=1)


def cubic(u: Callable[[Float], Float]) -> Diffusion:
    """−Δu + u³ = f, linearised."""
    return Diffusion(
        reaction=lambda x: 3.0 * u(x) ** 2,
        source=lambda x: 2.0 * np.pi**2 * exact(x) + exact(x) ** 3 + 2.0 * u(x) ** 3,
        exact=exact,
    )


@pytest.mark.parametrize("solver", ["polydg_mg", "direct"])
def test_the_convergence_is_quadratic(solver: str) -> None:
    iterates: list[Callable[[Float], Float]] = []

    def recorded(u: Callable[[Float], Float]) -> Diffusion:
        iterates.append(u)
        return cubic(u)

    found = agglo.newton(MESH, recorded, solver=solver, degree=2, tolerance=1e-12, change=1e-8)
    points = MESH.cell_centroids
    errors = [np.abs(u(points) - found.evaluate(points)).max() for u in iterates]
    assert len(errors) == 5
    assert errors[1] < 0.5 * errors[0]
    for error, following in pairwise(errors[1:4]):
        assert following <= 0.5 * error**2
    assert errors[4] <= 1e-9


def test_errors_have_the_order_of_the_degree() -> None:
    coarse, fine = (
        agglo.newton(samples.squares(n), cubic, degree=2, tolerance=1e-10).errors()["l2"] for n in (8, 16)
    )
    assert np.log2(coarse / fine) == pytest.approx(3.0, abs=0.2)


def test_frozen_coefficients_give_a_fixed_point() -> None:
    def frozen(u: Callable[[Float], Float]) -> Diffusion:  # u = ln(1 + x): −∇·(exp(u) ∇u) = 0
        return Diffusion(lambda x: np.exp(u(x)), 0.0, {0: lambda x: np.log1p(x[:, 0])})

    found = agglo.newton(samples.squares(8), frozen, degree=2, tolerance=1e-9, change=1e-8, max_steps=40)
    at = np.array([[0.3, 0.4], [0.71, 0.2]])
    assert found.evaluate(at) == pytest.approx(np.log1p(at[:, 0]), abs=1e-4)


def test_a_start_at_the_solution_takes_one_step() -> None:
    found = agglo.newton(MESH, cubic, degree=2, tolerance=1e-10)
    again = agglo.newton(MESH, cubic, found, degree=2, tolerance=1e-10, max_steps=1)
    assert again.x == pytest.approx(found.x, abs=1e-6 * np.abs(found.x).max())
    zero = agglo.newton(MESH, lambda u: Diffusion(source=0.0), max_steps=1)
    assert not zero.x.any()


def test_a_start_on_another_mesh_is_refused() -> None:
    found = agglo.newton(samples.squares(8), cubic, degree=2)
    with pytest.raises(OptionError, match=r"u0 has 384 unknowns on Mesh.*, expected 1800 on Mesh"):
        agglo.newton(MESH, cubic, found, degree=2)


def test_too_few_steps_raise_an_error_with_residual_and_steps() -> None:
    wanted = r"newton did not converge in 2 steps: the last changed u by 1\.\de-01 .* residual was 1\.\de-01"
    with pytest.raises(OptionError, match=wanted):
        agglo.newton(MESH, cubic, max_steps=2)
    with pytest.raises(OptionError, match="the linear problem of step 1 was not solved: relative residual"):
        agglo.newton(MESH, cubic, max_iterations=1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"linearised": 1.0}, "linearised must be a function of u that returns a Diffusion, given 1.0"),
        ({"linearised": lambda u: u}, "linearised must return a Diffusion, returned"),
        ({"change": 0.0}, "change must lie between 0 and 1, given 0.0"),
        ({"max_steps": 0}, "max_steps must be at least 1, given 0"),
        ({"solver": "polydg_cg"}, "requires a mesh, and a solver with repeated.*; given solver 'polydg_cg'"),
    ],
)
def test_invalid_arguments_are_refused(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(OptionError, match=message):
        agglo.newton(MESH, **{"linearised": cubic} | arguments)


def test_time_steps_linearise_a_stiff_reaction() -> None:
    """u' = −1000 u³ by linearly implicit steps, 30 times longer than explicit steps may be."""
    state: Any = None

    def linearised(t: float) -> Diffusion:
        u = (lambda x: np.ones(len(x))) if state is None else state.evaluate
        return Diffusion(
            reaction=lambda x: 3000.0 * u(x) ** 2, source=lambda x: 2000.0 * u(x) ** 3, neumann={0: 0.0}
        )

    for _, each in agglo.evolve(samples.squares(4), linearised, 1.0, 1.0, 0.02, "be"):
        state = each
    assert state.evaluate([[0.5, 0.5]]) == pytest.approx(1.0 / np.sqrt(2001.0), rel=0.1)
