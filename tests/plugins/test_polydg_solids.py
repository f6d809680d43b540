"""PolyDG in space, against an assembly made slowly from points of tetrahedra and triangles."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import eigvalsh
from scipy.sparse.linalg import eigsh, spsolve
from solid_meshes import MESHES, Array, gauss_tetrahedron, gauss_triangle, loops

from agglo_core import Mesh, MeshError, samples
from agglo_core.fields.coefficients import positive
from agglo_core.problems import Diffusion
from agglo_polydg_mg.forms.assembly import discretise, jump_penalty
from agglo_polydg_mg.forms.norms import errors
from agglo_polydg_mg.forms.penalty import simplex_heights
from agglo_polydg_mg.forms.sharp_penalty import MARGIN
from agglo_polydg_mg.polydg import PolyDG
from agglo_polydg_mg.space.basis import Basis, stiffness

NONE = np.empty(0, np.int64)

CUBIC = pytest.param(3, marks=pytest.mark.slow)


def tagged(mesh: Mesh) -> Mesh:
    """Boundary faces of value 2 where z = 1, of value 1 elsewhere."""
    top = mesh.face_centroids[:, 2] > 1 - 1e-9
    return replace(mesh, face_tags={"boundary": np.where(top, 2, 1)})


def slow_matrix(mesh: Mesh, degree: int, kappa: Array, sigma: Array) -> Array:
    """The bilinear form, point by point, dense; cells are signed tetrahedra over their faces."""
    basis, m = Basis(mesh, degree, True), Basis(mesh, degree).n_local
    A = np.zeros((basis.n, basis.n))
    faces = loops(mesh)
    tensors = kappa if kappa.ndim == 3 else kappa[:, None, None] * np.eye(3)
    points3, weights3 = gauss_tetrahedron(degree + 1)
    points2, weights2 = gauss_triangle(degree + 1)
    for c in range(mesh.n_cells):
        own, at, weights = slice(c * m, c * m + m), [], []
        for f, side in zip(*np.nonzero(mesh.face_cells == c), strict=True):
            for b, d in pairwise(faces[f][1:]):
                edges = np.array((faces[f][0], b, d))  # the origin is the last corner
                at.append(points3 @ edges)
                weights.append(np.linalg.det(edges) * (1 - 2 * side) * weights3)
        x, w = np.concatenate(at), np.concatenate(weights)
        slopes = basis.gradients(np.full(len(x), c), x)
        A[own, own] = np.einsum("q,qai,ab,qbj->ij", w, slopes, tensors[c], slopes, optimize=True)
    for f, (a, b) in enumerate(mesh.face_cells):
        cells = [a] if b < 0 else [a, b]
        rows = np.concatenate([np.arange(c * m, c * m + m) for c in cells])
        conormals = tensors[cells] @ mesh.face_normals[f]
        k = conormals @ mesh.face_normals[f]
        mean = k[0] if b < 0 else k[0] * k[1] / k.sum()
        stiff = sigma[f] * mean * (1 if b < 0 else 2)
        ring, normal, at, weights = faces[f], mesh.face_normals[f], [], []
        for first, second in pairwise(ring[1:]):
            across = np.cross(first - ring[0], second - ring[0])
            at.append(ring[0] + points2 @ np.array((first - ring[0], second - ring[0])))
            weights.append(np.sign(across @ normal) * np.linalg.norm(across) * weights2)
        x, w = np.concatenate(at), np.concatenate(weights)[:, None]
        jump = np.hstack(
            [s * basis.values(np.full(len(x), c), x) for s, c in zip((1, -1), cells, strict=False)]
        )
        slopes = [basis.gradients(np.full(len(x), c), x) for c in cells]
        flux = np.hstack([mean / d * (v @ g) for v, d, g in zip(conormals, k, slopes, strict=True)])
        A[np.ix_(rows, rows)] += jump.T @ (stiff * w * jump) - jump.T @ (w * flux) - flux.T @ (w * jump)
    return A


def tensors(sizes: Array) -> Array:
    """A tensor of each size, with random axes and ratios up to 1e4."""
    rng = np.random.default_rng(3)
    axes = np.linalg.qr(rng.standard_normal((len(sizes), 3, 3)))[0]
    values = sizes[:, None] * 10.0 ** rng.uniform(-4.0, 0.0, (len(sizes), 3))
    found = (axes * values[:, None]) @ axes.transpose(0, 2, 1)
    return np.asarray(0.5 * (found + found.transpose(0, 2, 1)))


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("degree", [1, 2, CUBIC])
@pytest.mark.parametrize("kind", ["scalars", "tensors"])
def test_matrices_are_those_of_a_slow_assembly(name: str, degree: int, kind: str) -> None:
    mesh = MESHES[name]
    kappa = np.random.default_rng(1).choice([1.0, 1e3], mesh.n_cells)
    kappa = kappa if kind == "scalars" else tensors(kappa)
    sigma = jump_penalty(Basis(mesh, degree, True), positive(mesh, kappa), "sharp", NONE)
    A = discretise(mesh, degree, Diffusion(kappa=kappa), penalty="sharp", scaled_basis=True).A.toarray()
    expected = slow_matrix(mesh, degree, kappa, sigma)
    scale = np.sqrt(np.outer(expected.diagonal(), expected.diagonal()))
    assert np.abs((A - expected) / scale).max() < 1e-11
    assert (A == A.T).all()
    assert eigvalsh(A / scale)[0] > 0


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("degree", [1, CUBIC])
def test_polynomials_are_reproduced(name: str, degree: int) -> None:
    """Values given on all sides but one, the flux there; κ is one number, and a function."""
    mesh = tagged(MESHES[name])

    def exact(x: Array) -> Array:
        return np.asarray((x @ (1.0, -0.5, 2.0) + 0.3) ** degree)

    def flux(x: Array) -> Array:
        return 2.0 * degree * 2.0 * (x @ (1.0, -0.5, 2.0) + 0.3) ** (degree - 1)

    def source(x: Array) -> Array:
        return -2.0 * degree * (degree - 1) * 5.25 * (x @ (1.0, -0.5, 2.0) + 0.3) ** max(degree - 2, 0)

    for kappa in (2.0, lambda x: np.full(len(x), 2.0)):
        problem = Diffusion(kappa=kappa, source=source, dirichlet={1: exact}, neumann={2: flux}, exact=exact)
        how = PolyDG(degree, "sharp", scaled_basis=True)
        system = how.assemble(problem, mesh)
        x = spsolve(system.A.tocsc(), system.b)
        expected = how.project(mesh, exact)
        assert np.abs(x - expected).max() < 1e-9 * np.abs(expected).max()
    found = errors(how.basis(mesh), x, problem, penalty="sharp")
    assert found.l2 < 1e-9
    assert found.dg < 1e-7


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_a_constant_penalty_serves_convex_cells(degree: int) -> None:
    mesh = samples.boxes(2)
    sigma = jump_penalty(Basis(mesh, degree), np.ones(8), 10.0, NONE)
    np.testing.assert_allclose(sigma, 3 * 10 * degree**2 / 0.5)
    with pytest.raises(MeshError, match="convex cells, but cells"):
        discretise(MESHES["hollow"], degree, Diffusion())


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("kind", ["scalars", "tensors"])
def test_the_sharp_penalty_keeps_its_margin(name: str, degree: int, kind: str) -> None:
    """Least eigenvalue of A beside the DG norm, made of jumps without normal derivatives."""
    mesh, rng = MESHES[name], np.random.default_rng(2)
    kappa = 10.0 ** rng.integers(-3, 4, mesh.n_cells)
    kappa = kappa if kind == "scalars" else tensors(kappa)
    basis = Basis(mesh, degree, True)
    sigma = jump_penalty(basis, positive(mesh, kappa), "sharp", NONE)
    huge = slow_matrix(mesh, degree, kappa, 1e9 * sigma)
    plain = slow_matrix(mesh, degree, kappa, 0.0 * sigma)
    inside, m = np.zeros_like(plain), basis.n_local
    for c, block in enumerate(stiffness(basis, positive(mesh, kappa))):
        inside[c * m : c * m + m, c * m : c * m + m] = block
    jumps = (huge - plain) / 1e9
    least = eigvalsh(plain + jumps, inside + jumps)[0]
    assert least > MARGIN - 1e-6


def test_energies_do_not_lock_and_eigenvalues_converge() -> None:
    """f = 8 on the unit cube: 1.2908; C = 10 leaves .806 with degree 1. The least eigenvalue is 3 π²."""
    mesh = samples.boxes(8)
    energies = {}
    for penalty in ("sharp", 10.0):
        system = discretise(mesh, 1, Diffusion(source=8.0), penalty=penalty, scaled_basis=True)
        energies[penalty] = float(system.b @ spsolve(system.A.tocsc(), system.b))
    assert energies["sharp"] == pytest.approx(1.2908, rel=0.01)
    assert energies[10.0] == pytest.approx(0.806, rel=0.01)
    gaps = []
    for n in (2, 4, 6):
        mesh = samples.boxes(n)
        system = discretise(mesh, 2, Diffusion(), penalty="sharp", scaled_basis=True)
        least = eigsh(system.A.tocsc(), 1, Basis(mesh, 2, True).mass().tocsc(), 0.0)[0][0]
        gaps.append(abs(least / (3 * np.pi**2) - 1))
    assert gaps[2] < 0.005
    assert gaps[0] > 7 * gaps[1]


def sine(x: Array) -> Array:
    first, second, third = np.sin(np.pi * x).T
    return np.asarray(first * second * third)


SINE = Diffusion(source=lambda x: 3 * np.pi**2 * sine(x), exact=sine)


def quarters(n: int) -> Mesh:
    """Blocks of 8 cubes each, with every other one grown into its neighbour."""
    mesh = samples.boxes(4 * n)
    c = np.floor(mesh.cell_centroids * 4 * n).astype(int)
    bent = c.copy()
    bent[:, 0] += np.where((c[:, 1] % 2 == 1) & (c[:, 0] < 4 * n - 1), 1, 0)
    return mesh.coarsen(np.unique(bent // 2 @ (1, 4 * n, 16 * n * n), return_inverse=True)[1])


ORDERS = {
    "hexahedra": (samples.boxes, ((5, 8), (3, 6), (3, 5))),
    "tetrahedra": (samples.tetrahedra, ((6, 10), (2, 4), (2, 4))),
    "Voronoi": (lambda n: samples.voronoi3d(n**3, seed=0), ((8, 12), (3, 6), (3, 6))),
    "agglomerates": (quarters, ((4, 6), (2, 3), (2, 3))),
}
_SLOW = ("tetrahedra", "Voronoi", "agglomerates")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in _SLOW else name for name in ORDERS]
)
@pytest.mark.parametrize("degree", [1, 2, CUBIC])
def test_errors_fall_with_the_size_of_the_cells(name: str, degree: int) -> None:
    """By their orders, p + 1 in L2 and p in the DG norm."""
    build, sizes = ORDERS[name]
    found, how = [], PolyDG(degree, "sharp", scaled_basis=True)
    for n in sizes[degree - 1]:
        mesh = build(n)
        system = how.assemble(SINE, mesh)
        x = spsolve(system.A.tocsc(), system.b)
        found.append(errors(how.basis(mesh), x, SINE, penalty="sharp"))
    finer = np.log(sizes[degree - 1][1] / sizes[degree - 1][0])
    assert np.log(found[0].l2 / found[1].l2) / finer > degree + 1 - 0.3
    assert np.log(found[0].dg / found[1].dg) / finer > degree - 0.2


def flat(mesh: Mesh, height: float) -> Mesh:
    """The mesh squeezed along a direction that is no axis."""
    way = np.array((1.0, 2.0, 3.0)) / np.sqrt(14.0)
    return replace(mesh, points=mesh.points - (1 - height) * np.outer(mesh.points @ way, way))


def test_cells_too_thin_for_their_stiffness_take_heights() -> None:
    mesh = flat(samples.tetrahedra(2), 1e-7)
    basis, kappa = Basis(mesh, 2, True), np.ones(mesh.n_cells)
    sigma = jump_penalty(basis, kappa, "sharp", NONE)
    heights = simplex_heights(mesh, np.ones(mesh.n_cells, bool))
    asked = 2 * 4 * 4 / heights  # p (p + 2) N over the height, N = 4
    inner = mesh.face_cells[:, 1] >= 0
    asked[inner] *= 0.25
    asked[~inner, 1] = 0.0
    np.testing.assert_allclose(sigma, asked.sum(axis=1) / (1 - MARGIN) ** 2, rtol=1e-9)
    varying = jump_penalty(basis, positive(mesh, lambda x: np.ones(len(x))), "sharp", NONE)
    np.testing.assert_allclose(varying, sigma, rtol=1e-9)
    with pytest.raises(MeshError, match="cell too thin for the sharp penalty"):
        discretise(flat(MESHES["hollow"], 1e-7), 2, Diffusion(), penalty="sharp", scaled_basis=True)


def test_offsets_of_boundary_data_cancel() -> None:
    """u = 1e6 + x on the boundary is u = x there and 1e6 everywhere."""
    mesh = tagged(MESHES["hollow"])
    found = []
    for offset in (0.0, 1e6):
        problem = Diffusion(source=1.0, dirichlet={tag: lambda x, c=offset: c + x[:, 0] for tag in (1, 2)})
        made = PolyDG(1, "sharp", scaled_basis=True).lifted(problem, mesh)
        found.append(spsolve(made.system.A.tocsc(), made.load) + (made.offset if offset else 0.0))
    expected = found[0] + Basis(mesh, 1, True).constants(np.full(mesh.n_cells, 1e6))
    np.testing.assert_allclose(found[1], expected, rtol=1e-9, atol=1e-9)
