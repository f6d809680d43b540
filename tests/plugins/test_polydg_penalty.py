"""The sharp penalty: coercive with its margin on any mesh, small enough to be worth it, and as documented."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import eigh, eigvalsh
from scipy.sparse.linalg import spsolve

import agglo_core as agglo
from agglo_core import Mesh, OptionError, samples
from agglo_core.arrays import frozen_float
from agglo_core.fields.coefficients import positive
from agglo_core.fields.gauss_points import gauss
from agglo_core.problems import Diffusion
from agglo_polydg_mg.forms.assembly import discretise, jump_penalty
from agglo_polydg_mg.forms.coefficients import reaction_blocks
from agglo_polydg_mg.forms.face_quadrature import all_faces, face_coefficients, face_rule
from agglo_polydg_mg.forms.form_kernels import largest_bounds
from agglo_polydg_mg.forms.norms import Errors, errors
from agglo_polydg_mg.forms.sharp_penalty import MARGIN
from agglo_polydg_mg.forms.trace_kernels import side_penalties
from agglo_polydg_mg.paper.paper_multigrid import PaperMultigrid
from agglo_polydg_mg.plain_cg import PlainCG
from agglo_polydg_mg.polydg import PolyDG
from agglo_polydg_mg.space.basis import Basis, block_diagonal, stiffness
from agglo_polydg_mg.space.legendre_kernels import LANES

Array = NDArray[np.float64]


def agglomerated(mesh: Mesh, parts: int) -> Mesh:
    return mesh.coarsen(agglo.agglomerate(mesh.graph, n_parts=parts).levels[0])


def scattered(mesh: Mesh, parts: int, rng: np.random.Generator) -> Mesh:
    """Agglomerates in pieces, with holes and pinch vertices."""
    return mesh.coarsen(rng.permutation(np.arange(mesh.n_cells) % parts))


def sheared(mesh: Mesh, thickness: float) -> Mesh:
    """The mesh squeezed in y, then turned by a radian: slivers along no axis."""
    c, s = np.cos(1.0), np.sin(1.0)
    squeezed = mesh.points * (1.0, thickness)
    return replace(mesh, points=squeezed @ np.array([[c, s], [-s, c]]))


def tiny_face() -> Mesh:
    """Four cells in a square that do not quite meet: a face of 1e-7 keeps two of them apart."""
    inner = [(0.5, 0.5), (0.5 + 1e-7, 0.5 + 1e-7)]
    points = [(0, 0), (0.5, 0), (1, 0), (1, 0.5), (1, 1), (0.5, 1), (0, 1), (0, 0.5), *inner]
    cells = [[0, 1, 8, 7], [1, 2, 3, 9, 8], [3, 4, 5, 9], [7, 8, 9, 5, 6]]
    return Mesh.from_polygons(np.array(points, float), [np.array(each) for each in cells], name="tiny face")


def holed(n: int) -> Mesh:
    """Frames of squares, one in the hole of the other."""
    column, row = np.arange(n * n) % n, np.arange(n * n) // n
    return samples.squares(n).coarsen(np.minimum.reduce((column, row, n - 1 - column, n - 1 - row)))


def energies(mesh: Mesh, degree: int, problem: Diffusion) -> tuple[Array, Array]:
    """The matrix and the square of the DG norm, made independently from points on the faces, dense."""
    basis, how = Basis(mesh, degree, True), {"penalty": "sharp", "scaled_basis": True}
    A = discretise(mesh, degree, problem, **how).A.toarray()
    kappa = positive(mesh, problem.kappa)
    natural = np.flatnonzero((mesh.face_cells[:, 1] < 0) & ~_held(mesh, problem))
    sigma = jump_penalty(basis, kappa, "sharp", natural)
    rule = degree + 2
    on, points = (
        face_coefficients(mesh, kappa, all_faces(mesh), rule),
        face_rule(mesh, np.arange(mesh.n_faces), rule).points,
    )
    m, norm = basis.n_local, np.zeros((basis.n, basis.n))
    blocks = stiffness(basis, kappa)
    for c in range(mesh.n_cells):
        norm[c * m : c * m + m, c * m : c * m + m] = blocks[c]
    for f, (a, b) in enumerate(mesh.face_cells):
        jump = np.zeros((rule, basis.n))
        jump[:, a * m : a * m + m] = basis.values(np.full(rule, a), points[f])
        if b >= 0:
            jump[:, b * m : b * m + m] -= basis.values(np.full(rule, b), points[f])
        harmonic = 2 * on[f, 0] * on[f, 1] / (on[f, 0] + on[f, 1])
        weights = 0.5 * gauss(rule)[1] * mesh.face_measures[f] * sigma[f] * harmonic
        norm += jump.T @ (weights[:, None] * jump)
    reaction = reaction_blocks(basis, problem.reaction)
    if reaction is not None:
        norm += block_diagonal(reaction).toarray()
    return A, norm


def _held(mesh: Mesh, problem: Diffusion) -> NDArray[np.bool_]:
    if not problem.dirichlet:
        return np.ones(mesh.n_faces, bool)
    return np.isin(mesh.face_tags[problem.boundary], list(problem.dirichlet))


def margin(mesh: Mesh, degree: int, problem: Diffusion) -> float:
    """Smallest eigenvalue of the matrix relative to the DG norm."""
    A, norm = energies(mesh, degree, problem)
    scale = 1 / np.sqrt(np.diag(norm))
    return float(eigh(A * scale[:, None] * scale, norm * scale[:, None] * scale, eigvals_only=True)[0])


def shortfall(mesh: Mesh, degree: int, problem: Diffusion) -> float:
    """How far A − MARGIN · (DG norm) is from positive semidefinite, both scaled to a unit diagonal of A.

    Flat cells at high degree have polynomials that rounding cannot tell from 0: relative to their norm the
    smallest eigenvalue means nothing, but negative by more than rounding it may not be.
    """
    A, norm = energies(mesh, degree, problem)
    scale = 1 / np.sqrt(np.diag(A))
    least = eigh((A - MARGIN * norm) * scale[:, None] * scale, eigvals_only=True)[0]
    return max(0.0, -float(least))


def jumping(mesh: Mesh, rng: np.random.Generator) -> Diffusion:
    """κ of either 1 or 1e6 in each cell."""
    return Diffusion(kappa=rng.choice([1.0, 1e6], mesh.n_cells))


def tilted(mesh: Mesh, rng: np.random.Generator) -> Diffusion:
    """A random tensor in each cell, with ratios up to 1e6, and reaction up to 1e8."""
    angle, ratio = rng.uniform(0.0, np.pi, mesh.n_cells), 10.0 ** rng.uniform(-6.0, 0.0, mesh.n_cells)
    axis = np.stack((np.cos(angle), np.sin(angle)), axis=1)
    along = axis[:, :, None] * axis[:, None]
    across = np.eye(2) - along
    kappa = 10.0 ** rng.uniform(-2.0, 2.0, (mesh.n_cells, 1, 1)) * (along + ratio[:, None, None] * across)
    return Diffusion(kappa, reaction=rng.choice([0.0, 1.0, 1e8], mesh.n_cells))


def turning(x: Array) -> Array:
    """A tensor with the ratio 1e4 that turns."""
    angle = 3.0 * x[:, 0] + 2.0 * x[:, 1]
    axis = np.stack((np.cos(angle), np.sin(angle)), axis=1)
    return np.asarray(1e-4 * np.eye(2) + axis[:, :, None] * axis[:, None])


TURNING = Diffusion(turning)
WAVE = Diffusion(kappa=lambda x: 1.0 + 0.95 * np.sin(7 * x[:, 0]) * np.cos(5 * x[:, 1]))
CASES: dict[str, Callable[[np.random.Generator], Mesh]] = {
    "squares": lambda rng: samples.squares(4),
    "voronoi": lambda rng: samples.voronoi(20, seed=int(rng.integers(99))),
    "random triangles": lambda rng: samples.random_triangles(30, seed=int(rng.integers(99))),
    "agglomerated": lambda rng: agglomerated(samples.voronoi(120, seed=int(rng.integers(99))), 12),
    "agglomerated triangles": lambda rng: agglomerated(samples.random_triangles(150, seed=3), 10),
    "scattered": lambda rng: scattered(samples.voronoi(60, seed=1), 8, rng),
    "holed": lambda rng: holed(7),
    "tiny face": lambda rng: tiny_face(),
    "slivers": lambda rng: sheared(samples.voronoi(20, seed=int(rng.integers(99))), 1e-2),
}


@pytest.mark.parametrize("name", CASES)
def test_coercive_with_the_margin(name: str) -> None:
    rng = np.random.default_rng(len(name))
    mesh, degree = CASES[name](rng), 1 + len(name) % 3
    for problem in (Diffusion(), jumping(mesh, rng), WAVE, tilted(mesh, rng), TURNING):
        assert margin(mesh, degree, problem) >= MARGIN * (1 - 1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(36))
@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_coercive_on_all_meshes_with_all_coefficients(seed: int, degree: int) -> None:
    rng = np.random.default_rng(1000 * degree + seed)
    mesh = list(CASES.values())[seed % len(CASES)](rng)
    problem = (Diffusion(), jumping(mesh, rng), tilted(mesh, rng), WAVE, TURNING)[seed % 5]
    assert shortfall(mesh, degree, problem) <= 1e-11
    if degree < 3:
        assert margin(mesh, degree, problem) >= MARGIN * (1 - 1e-6)


def test_the_margin_is_reached_and_so_not_idle() -> None:
    """Hardly more than what is promised: the penalty could not be much smaller."""
    mesh = samples.squares(6)
    assert margin(mesh, 2, jumping(mesh, np.random.default_rng(0))) < MARGIN * 1.1


def test_on_one_square_the_constant_is_that_of_the_formula() -> None:
    """p = 1: v = x has its slope on two faces of length h, ∫_F c / s = 2 h / s <= |K| = h², s = 2 / h."""
    mesh = replace(samples.squares(1), points=0.5 * samples.squares(1).points)
    sigma = jump_penalty(Basis(mesh, 1), np.ones(1), "sharp", np.empty(0, np.int64))
    exact = 2 / 0.5 / (1 - MARGIN) ** 2
    assert (sigma >= exact).all()
    np.testing.assert_allclose(sigma, exact, rtol=1.0001 * (2 ** (1 / 64) - 1))  # the bound of the eigenvalue


@pytest.mark.parametrize("callable_kappa", [False, True])
def test_the_penalty_of_a_cell_is_sufficient_and_sharp(callable_kappa: bool) -> None:
    """The eigenproblem of each cell by scipy: 1 up to the bound of its largest eigenvalue."""
    mesh, degree = scattered(samples.voronoi(40, seed=4), 5, np.random.default_rng(1)), 3
    basis = Basis(mesh, degree)
    kappa = positive(mesh, WAVE.kappa if callable_kappa else np.linspace(1, 9, 5))
    on, blocks = face_coefficients(mesh, kappa, all_faces(mesh), degree + 2), stiffness(basis, kappa)
    rule = degree if on.shape[2] == 1 else degree + 2
    fill = frozen_float(mesh.cell_measures / (4 * basis.boxes[:, 2] * basis.boxes[:, 3]))
    asked = np.zeros((mesh.n_faces, 2))
    resolved = side_penalties(
        mesh.local_points, *mesh.cell_faces, mesh.face_pairs, mesh.face_cells, 0,
        np.ones(mesh.n_faces, bool), basis.boxes, basis.scale, fill, blocks, on, np.zeros((0, 2, 1, 2)),
        *gauss(rule), degree, asked,
    )  # fmt: skip
    assert resolved.all()
    for c in range(mesh.n_cells):
        sums = np.zeros_like(blocks[c])
        for f, side in zip(*np.nonzero(mesh.face_cells == c), strict=True):
            points = face_rule(mesh, np.array([f]), rule).points[0]
            slopes = basis.gradients(np.full(rule, c), points).transpose(0, 2, 1) @ mesh.face_normals[f]
            own, other = on[f, side], on[f, 1 - side]
            share = own if mesh.face_cells[f, 1] < 0 else 0.5 * own * other / (own + other)
            weights = 0.5 * gauss(rule)[1] * mesh.face_measures[f] * share / asked[f, side]
            sums += slopes.T @ (weights[:, None] * slopes)
        largest = eigvalsh(sums[1:, 1:], blocks[c, 1:, 1:])[-1]
        assert 9 ** (-1 / 64) * (1 - 1e-9) < largest <= 1 + 1e-9


def asked_of(S: Array, forms: Array, lengths: Array) -> Array:
    """What a cell asks of its faces, by the formulas of the page on mathematics."""
    L = np.linalg.inv(np.linalg.cholesky(S))
    T = L @ forms @ L.T
    best, metric = None, np.eye(len(S))
    for _ in range(2):
        w = np.sqrt(np.trace(metric @ metric @ T, axis1=1, axis2=2) / lengths)
        metric = (T / w[:, None, None]).sum(axis=0)
        values = eigvalsh(metric)
        s = w * values[-1] * ((values / values[-1]) ** 64).sum() ** (1 / 64)
        best = s if best is None or lengths @ s < lengths @ best else best
    return np.asarray(best)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_penalties_of_cells_agree_with_the_formulas(degree: int) -> None:
    """Of more cells than are taken at a time."""
    mesh, rng = samples.voronoi(90, seed=7), np.random.default_rng(degree)
    basis, kappa = Basis(mesh, degree, True), rng.uniform(1, 9, mesh.n_cells)
    on, blocks = face_coefficients(mesh, kappa, all_faces(mesh), degree), stiffness(basis, kappa)
    expected = np.zeros((mesh.n_faces, 2))
    for c in range(mesh.n_cells):
        faces, sides = np.nonzero(mesh.face_cells == c)
        forms = []
        for f, side in zip(faces, sides, strict=True):
            points = face_rule(mesh, np.array([f]), degree).points[0]
            slopes = basis.gradients(np.full(degree, c), points).transpose(0, 2, 1) @ mesh.face_normals[f]
            own, other = on[f, side, 0], on[f, 1 - side, 0]
            share = own if mesh.face_cells[f, 1] < 0 else 0.5 * own * other / (own + other)
            weights = 0.5 * gauss(degree)[1] * mesh.face_measures[f] * share
            forms.append((slopes.T @ (weights[:, None] * slopes))[1:, 1:])
        expected[faces, sides] = asked_of(blocks[c, 1:, 1:], np.array(forms), mesh.face_measures[faces])
    sigma = jump_penalty(basis, kappa, "sharp", np.empty(0, np.int64))
    np.testing.assert_allclose(sigma, expected.sum(axis=1) / (1 - MARGIN) ** 2, rtol=1e-10)


@pytest.mark.parametrize("n", [2, 9, 27])
def test_the_bound_of_the_largest_eigenvalue(n: int) -> None:
    rng = np.random.default_rng(n)
    lanes, most, sums, found = np.zeros((n, n, LANES)), np.zeros(LANES), np.zeros(LANES), np.empty(LANES)
    for lane in range(LANES - 1):  # the last one stays 0
        values = rng.uniform(0.0, 1.0, n) ** rng.choice([0.0, 0.1, 3.0]) * 10.0 ** rng.uniform(-150, 150)
        turn = np.linalg.qr(rng.standard_normal((n, n)))[0]
        lanes[:, :, lane] = np.tril(turn * values @ turn.T)
        most[lane] = values.max()
        sums[lane] = most[lane] * ((values / most[lane]) ** 64).sum() ** (1 / 64)
    largest_bounds(lanes, found)
    assert (found >= most * (1 - 1e-12)).all()
    assert (found <= most * n ** (1 / 64) * (1 + 1e-12)).all()
    np.testing.assert_allclose(found, sums, rtol=1e-12)


@pytest.mark.parametrize("thickness", [1e-3, 1e-6])
def test_cells_too_thin_for_rounding_get_a_safe_penalty(thickness: float) -> None:
    """Triangles that fit on faces give more than what is needed, which turning to the axes shows."""
    turned, plain = sheared(samples.squares(3), thickness), samples.squares(3)
    plain = replace(plain, points=plain.points * (1.0, thickness))
    for kappa in (np.ones(9), lambda x: 1.0 + 0.0 * x[:, 0]):
        none = np.empty(0, np.int64)
        found, exact = (jump_penalty(Basis(m, 4), kappa, "sharp", none) for m in (turned, plain))
        assert (found > 0.8 * exact).all()
        assert found.max() < 60 * exact.max()


def test_natural_faces_have_no_penalty_and_ask_for_none() -> None:
    mesh, none = samples.squares(3), np.empty(0, np.int64)
    natural = np.flatnonzero(mesh.face_cells[:, 1] < 0)[:2]
    with_all, without = (jump_penalty(Basis(mesh, 2), np.ones(9), "sharp", each) for each in (none, natural))
    assert (without[natural] == 0).all()
    assert (without <= with_all * (1 + 1e-12)).all()
    assert without.sum() < with_all.sum() - with_all[natural].sum()


def sine(x: Array) -> Array:
    return np.asarray(np.sin(np.pi * x[:, 0]) * np.sin(np.pi * x[:, 1]))


SINE = Diffusion(source=lambda x: 2 * np.pi**2 * sine(x), exact=sine)


def solved(mesh: Mesh, degree: int, penalty: str) -> Errors:
    system = discretise(mesh, degree, SINE, penalty=penalty)
    return errors(Basis(mesh, degree), spsolve(system.A.tocsc(), system.b), SINE, penalty=penalty)


FAMILIES: dict[str, Callable[[int], Mesh]] = {
    "squares": lambda n: samples.squares(n),
    "voronoi": lambda n: samples.voronoi(n * n, seed=2),
    "agglomerated": lambda n: agglomerated(samples.voronoi(8 * n * n, seed=3), n * n),
}


@pytest.mark.parametrize("name", FAMILIES)
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_orders_of_convergence(name: str, degree: int) -> None:
    coarse, fine = (solved(FAMILIES[name](n), degree, "sharp") for n in (5, 10))
    slack = 0.15 if name == "squares" else 0.4  # random meshes are not similar to each other
    assert np.log2(coarse.l2 / fine.l2) > degree + 1 - slack
    assert np.log2(coarse.dg / fine.dg) > degree - slack


def test_errors_on_agglomerates_are_smaller() -> None:
    mesh = agglomerated(samples.voronoi(1000, seed=3), 64)
    paper, sharp = (solved(mesh, 1, each) for each in ("paper", "sharp"))
    assert sharp.l2 < 0.4 * paper.l2
    assert sharp.dg < paper.dg


def test_the_option() -> None:
    mesh = samples.voronoi(12, seed=0)
    named, number, sharp = (
        PolyDG(2, each, False).assemble(SINE, mesh).A.toarray() for each in ("paper", 10.0, "sharp")
    )
    assert (named == number).all()
    assert (sharp != number).any()
    for bad in ("dull", "", "10"):
        with pytest.raises(OptionError, match="penalty must be a positive number, 'paper' or 'sharp'; given"):
            PolyDG(1, bad, False)  # type: ignore[arg-type]


def test_the_papers_solvers_accept_the_sharp_penalty() -> None:
    mesh = samples.voronoi(80, seed=5)
    hierarchy = agglo.agglomerate(mesh, n_parts=(20, 5))
    found = [
        make(degree=2, penalty="sharp", tolerance=1e-9).solve(SINE, hierarchy)
        for make in (PaperMultigrid, PlainCG)
    ]
    assert all(each.converged for each in found)
    np.testing.assert_allclose(found[0].x, found[1].x, atol=1e-6 * abs(found[0].x).max())
