"""Patch multigrid for PolyDG: few iterations on fresh meshes in both precisions, symmetry, exactness."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse.linalg import cg, splu

from agglo_core import agglomerate, samples
from agglo_core.errors import OptionError
from agglo_core.mesh import Mesh
from agglo_core.multigrid import LevelStack, cycle
from agglo_core.problems import Diffusion, System
from agglo_polydg_mg.auxiliary.patch_recipe import patch_stack
from agglo_polydg_mg.forms.assembly import discretise
from agglo_polydg_mg.space.basis import Basis

FRESH = 20261122


def levels_of(mesh: Mesh, *sizes: int) -> list[np.ndarray]:
    return list(agglomerate(mesh, bisector="coordinate", refiners=(), cells_per_part=sizes, seed=0).levels)


def prepared(mesh: Mesh, degree: int, dtype: type) -> tuple[System, LevelStack]:
    system = discretise(mesh, degree, Diffusion(source=8.0), scaled_basis=True)
    stack = patch_stack(Basis(mesh, degree, True), system.A, levels_of(mesh, 8, 64), dtype)
    return system, stack


def iterations(system: System, stack: LevelStack, tolerance: float) -> int:
    seen: list[None] = []
    x, failed = cg(
        system.A, system.b, rtol=tolerance, maxiter=60, M=cycle(stack), callback=lambda _: seen.append(None)
    )
    assert failed == 0
    assert np.linalg.norm(system.b - system.A @ x) <= 2 * tolerance * np.linalg.norm(system.b)
    return len(seen)


@pytest.mark.parametrize(
    ("name", "degree", "most"),
    [
        ("squares", 1, 18),
        ("squares", 2, 15),
        ("triangles", 1, 18),
        ("triangles", 3, 15),
        ("voronoi", 1, 25),
        ("voronoi", 2, 26),
        ("random_triangles", 1, 32),
        ("random_triangles", 2, 30),
    ],
)
def test_few_iterations_in_single_precision(name: str, degree: int, most: int) -> None:
    mesh = {
        "squares": lambda: samples.squares(30),
        "triangles": lambda: samples.triangles(20),
        "voronoi": lambda: samples.voronoi(800, seed=FRESH),
        "random_triangles": lambda: samples.random_triangles(400, seed=FRESH),
    }[name]()
    system, stack = prepared(mesh, degree, np.float32)
    assert len(stack.levels) >= 2
    assert stack.operator_complexity < 1.6
    assert stack.levels[0].A.dtype == np.float32
    assert iterations(system, stack, 1e-10) <= most, f"seed {FRESH}"


def test_flat_triangles_need_no_more_iterations_in_single_precision_than_in_double() -> None:
    mesh = samples.random_triangles(300, seed=FRESH)
    used = [iterations(*prepared(mesh, 3, dtype), 1e-8) for dtype in (np.float32, np.float64)]
    assert used[0] <= used[1] + 3, f"seed {FRESH}"


def test_the_cycle_is_symmetric_and_positive() -> None:
    system, stack = prepared(samples.voronoi(600, seed=FRESH), 1, np.float64)
    u, v = np.random.default_rng(FRESH).standard_normal((2, system.A.shape[0]))
    M = cycle(stack)
    assert u @ (M @ v) == pytest.approx(v @ (M @ u), rel=1e-8, abs=1e-10 * np.linalg.norm(M @ u))
    assert u @ (M @ u) > 0.0


def test_a_small_problem_is_solved_at_once() -> None:
    mesh = samples.squares(6)
    system, stack = prepared(mesh, 2, np.float64)
    assert len(stack.levels) == 1
    exact = splu(system.A.tocsc()).solve(system.b)
    assert np.allclose(cycle(stack) @ system.b, exact, rtol=1e-8)


def test_levels_that_do_not_nest_are_refused() -> None:
    mesh = samples.squares(40)
    basis = Basis(mesh, 2, True)
    A = discretise(mesh, 2, Diffusion(), scaled_basis=True).A
    labels = [np.arange(1600) // 4, (np.arange(1600) + 2) % 1600 // 8]
    with pytest.raises(OptionError, match="level 1 are not unions"):
        patch_stack(basis, A, labels)
