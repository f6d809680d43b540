"""What the discretisation promises: exactness, orders, positivity, robustness, clear refusals."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse
from scipy.io import loadmat
from scipy.sparse.linalg import eigsh, spsolve

import agglo_core as agglo
from agglo_core import AggloError, Mesh, OptionError, agglomerate, samples
from agglo_core.problems import Diffusion, System
from agglo_polydg_mg.forms.assembly import discretise, load
from agglo_polydg_mg.forms.coefficients import cell_means
from agglo_polydg_mg.forms.norms import Errors, errors
from agglo_polydg_mg.polydg import PolyDG
from agglo_polydg_mg.space.basis import Basis

Array = NDArray[np.float64]
FILES = Path(os.environ.get("AGGLO_MESH_FILES", Path(__file__).parents[2] / "shared/data/meshes"))


def solved(system: System) -> Array:
    """Direct solution."""
    x: Array = spsolve(sparse.csc_array(system.A), system.b)
    return x


def error(mesh: Mesh, degree: int, problem: Diffusion, **options: float) -> Errors:
    """Errors of the direct solution."""
    system = discretise(mesh, degree, problem, **options)
    return errors(Basis(mesh, degree, bool(options.get("scaled_basis"))), solved(system), problem)


def sine(x: Array) -> Array:
    """The paper's solution on the unit square."""
    value: Array = np.sin(np.pi * x[:, 0]) * np.sin(np.pi * x[:, 1])
    return value


SINE = Diffusion(source=lambda x: 2 * np.pi**2 * sine(x), exact=sine)


def polynomial(degree: int) -> Diffusion:
    """u = (x + 2y)^p + (x − y)^(p−1), held on the whole boundary."""

    def exact(x: Array) -> Array:
        s, t = x[:, 0] + 2 * x[:, 1], x[:, 0] - x[:, 1]
        return np.asarray(s**degree + t ** (degree - 1))

    def source(x: Array) -> Array:
        s, t, p = x[:, 0] + 2 * x[:, 1], x[:, 0] - x[:, 1], degree
        first = 5 * p * (p - 1) * s ** max(p - 2, 0)
        return np.asarray(-first - 2 * (p - 1) * (p - 2) * t ** max(p - 3, 0))

    return Diffusion(source=source, dirichlet={0: exact}, exact=exact)


def scattered(mesh: Mesh, parts: int, seed: int = 0) -> Mesh:
    """Agglomerates in pieces, with holes and pinch vertices."""
    return mesh.coarsen(np.random.default_rng(seed).permutation(np.arange(mesh.n_cells) % parts))


@cache
def agglomerated(parts: int) -> Mesh:
    """Voronoi cells, eight to a part."""
    mesh = samples.voronoi(8 * parts, seed=3)
    return mesh.coarsen(agglo.agglomerate(mesh.graph, n_parts=parts).levels[0])


def typ2(name: str) -> Mesh:
    """A mesh of the 2-D benchmark on anisotropic diffusion: vertices, then cells as count and vertices."""
    lines = (FILES / name).read_text().split("\n")
    n = int(lines[1])
    points = np.array([line.split() for line in lines[2 : 2 + n]], float)
    start = next(i for i, line in enumerate(lines) if line.strip().lower() == "cells")
    count = int(lines[start + 1])
    cells = [np.array(line.split()[1:], int) - 1 for line in lines[start + 2 : start + 2 + count]]
    return Mesh.from_polygons(points, cells, name=name)


def nonconvex() -> Mesh:
    """Non-convex hexagons and heptagons of the mixed virtual element library."""
    data = loadmat(FILES / "mvem_meshdata_nonconvex3.mat")
    cells = [cell.ravel().astype(int) - 1 for cell in data["elem"][:, 0]]
    return Mesh.from_polygons(data["node"], cells, name="nonconvex3")


def in_unit_square(mesh: Mesh) -> Mesh:
    """The mesh moved and scaled into the unit square."""
    low = mesh.points.min(axis=0)
    return replace(mesh, points=(mesh.points - low) / np.ptp(mesh.points, axis=0).max())


FROM_FILES: dict[str, Callable[[], Mesh]] = {
    "nonconvex3": nonconvex,
    "non_conforming": lambda: typ2("hardcore2d_non_conforming_3.typ2"),
    "mesh4 (oblique)": lambda: typ2("hardcore2d_mesh4_1_2.typ2"),
    "Emilia": lambda: in_unit_square(agglo.read(FILES / "magnet_MeshEmilia.vtk")),
    "hexagons": lambda: typ2("hardcore2d_hexa1_2.typ2"),
}
needs_files = pytest.mark.skipif(not FILES.exists(), reason=f"no meshes at {FILES} (set AGGLO_MESH_FILES)")

MESHES: dict[str, Callable[[], Mesh]] = {
    "squares": lambda: samples.squares(4),
    "random triangles": lambda: samples.random_triangles(30, seed=2),
    "voronoi": lambda: samples.voronoi(30, seed=3),
    "agglomerated": lambda: agglomerated(12),
    "scattered": lambda: scattered(samples.voronoi(60, seed=1), 8),
    "bent": lambda: bent(3),
    "one cell with a hole": lambda: samples.ring(24).coarsen(np.zeros(samples.ring(24).n_cells, int)),
}


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("degree", [1, 2, 3, 4, 6])
def test_polynomials_of_the_degree_are_solved_exactly(name: str, degree: int) -> None:
    mesh, problem = MESHES[name](), polynomial(degree)
    for scaled in (False, True):
        found = error(mesh, degree, problem, scaled_basis=scaled)
        assert found.l2 < 1e-10 * max(1.0, size_of(mesh, problem))


def size_of(mesh: Mesh, problem: Diffusion) -> float:
    """Largest value of the exact solution at the points of the mesh."""
    assert problem.exact is not None
    return float(abs(problem.exact(mesh.points)).max())


@needs_files
@pytest.mark.slow
@pytest.mark.parametrize("name", FROM_FILES)
@pytest.mark.parametrize("degree", [1, 3])
def test_patch_on_published_meshes(name: str, degree: int) -> None:
    mesh, problem = FROM_FILES[name](), polynomial(degree)
    assert error(mesh, degree, problem).l2 < 1e-10 * size_of(mesh, problem)


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("degree", [1, 3])
def test_symmetric_and_positive_definite(name: str, degree: int) -> None:
    mesh = MESHES[name]()
    kappa = np.geomspace(1, 1e6, mesh.n_cells)
    A = discretise(mesh, degree, Diffusion(kappa=kappa), scaled_basis=True).A.toarray()
    assert (A == A.T).all()
    assert np.linalg.eigvalsh(A).min() > 0


def test_smallest_eigenvalue_is_that_of_the_square() -> None:
    found = []
    for degree in (1, 2, 3):
        system = discretise(samples.voronoi(150, seed=2), degree, Diffusion())
        mass = sparse.csc_array(Basis(system.mesh, degree).mass())
        (value,) = eigsh(sparse.csc_array(system.A), k=1, M=mass, sigma=15.0)[0]
        found.append(abs(value / (2 * np.pi**2) - 1))
    assert found[0] < 0.1
    assert found[1] < 2e-3
    assert found[2] < 1e-5


ROUGH = 0.2  # three meshes, some of random cells, p = 1 not yet in the limit

FAMILIES: dict[str, Callable[[int], Mesh]] = {
    "squares": samples.squares,
    "non-convex": lambda n: bent(n),
    "voronoi": cache(lambda n: samples.voronoi(n * n, seed=n)),
    "agglomerated": lambda n: agglomerated(n * n),
}


def bent(n: int) -> Mesh:
    """Octagons, all but one non-convex: squares whose inner sides are broken at their middles."""
    squares = samples.squares(n)
    inner = squares.face_cells[:, 1] >= 0
    middles = squares.points[squares.face_pairs].mean(axis=1)
    middles[inner] += 0.3 / n * squares.face_normals[inner]
    number = {(a, b): k for k, pair in enumerate(squares.face_pairs.tolist()) for a, b in (pair, pair[::-1])}
    cells = []
    for corners in squares.boundary_loops.vertices.reshape(-1, 4).tolist():
        sides = zip(corners, [*corners[1:], corners[0]], strict=True)
        cells.append([v for a, b in sides for v in (a, squares.n_points + number[a, b])])
    return Mesh.from_polygons(np.concatenate((squares.points, middles)), cells, name="bent")


def test_the_cells_called_non_convex_are_so() -> None:
    polygons = bent(5).to_shapely()
    assert sum(each.convex_hull.area > 1.01 * each.area for each in polygons) == 24
    assert bent(5).cell_measures.sum() == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("name", "degree"),
    [
        pytest.param(name, degree, marks=() if name == "voronoi" or degree == 2 else pytest.mark.slow)
        for name in FAMILIES
        for degree in (1, 2, 3, 4)
    ],
)
def test_orders_of_convergence(name: str, degree: int) -> None:
    """p + 1 in L2 and p in the DG norm, fitted over three meshes; h is the root of the mean area."""
    sides = {1: (16, 32, 64)}.get(degree, (5, 10, 20))
    if name in ("voronoi", "agglomerated") and degree == 1:
        sides = (8, 16, 32)
    meshes = [FAMILIES[name](n) for n in sides]
    found = np.array([error(mesh, degree, SINE) for mesh in meshes])
    sizes = [mesh.n_cells**-0.5 for mesh in meshes]
    l2, h1, dg = np.polyfit(np.log(sizes), np.log(found), 1)[0]
    assert l2 > degree + 1 - ROUGH
    assert min(h1, dg) > degree - ROUGH


@needs_files
@pytest.mark.parametrize("degree", [1, 3])
def test_orders_on_non_convex_cells(degree: int) -> None:
    """The published non-convex mesh, and four copies of it at half the size."""
    coarse = nonconvex()
    shifts = np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
    points = np.concatenate([0.5 * (coarse.points + shift) for shift in shifts])
    offsets, vertices = coarse.boundary_loops[1:]
    many = np.concatenate([vertices + k * coarse.n_points for k in range(4)])
    ends = np.concatenate(([0], np.cumsum(np.tile(np.diff(offsets), 4))))
    fine = Mesh.from_polygons(np.round(points, 12), (ends, many), merge_points=True)
    assert fine.face_cells.min(axis=1).tolist().count(-1) == 2 * (coarse.face_cells.min(axis=1) < 0).sum()
    l2, h1, dg = np.log2(np.divide(error(coarse, degree, SINE), error(fine, degree, SINE)))
    assert l2 > degree + 1 - ROUGH
    assert min(h1, dg) > degree - ROUGH


def sloped(ratio: float, mesh: Mesh) -> Diffusion:
    """Two materials beside x = 1/2, u and κ ∂u/∂x continuous there; κ by cell; smooth on both sides."""

    def exact(x: Array) -> Array:
        shape = np.sin(np.pi * (x[:, 0] - 0.5)) * np.cos(x[:, 1])
        return np.asarray(shape / np.where(x[:, 0] < 0.5, 1.0, ratio))

    def source(x: Array) -> Array:
        return np.asarray((np.pi**2 + 1) * np.sin(np.pi * (x[:, 0] - 0.5)) * np.cos(x[:, 1]))

    kappa = np.where(mesh.cell_centroids[:, 0] < 0.5, 1.0, ratio)
    return Diffusion(kappa=kappa, source=source, dirichlet={0: exact}, exact=exact)


def in_halves(parts: int) -> Mesh:
    """Agglomerates in pieces, with pinch vertices, none of which crosses x = 1/2."""
    mesh = samples.squares(16)
    right = mesh.cell_centroids[:, 0] > 0.5
    return mesh.coarsen(np.random.default_rng(1).permutation(256) % parts + parts * right)


@pytest.mark.parametrize("mesh", [samples.squares(8), in_halves(20)], ids=["squares", "agglomerates"])
@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_error_in_energy_does_not_depend_on_the_jump_of_kappa(degree: int, mesh: Mesh) -> None:
    found = [error(mesh, degree, sloped(10.0**k, mesh)).dg for k in (1, 3, 6)]
    assert max(found) < 1.05 * min(found)


def test_kappa_as_array_and_as_callable_that_jumps_on_faces_agree() -> None:
    mesh = samples.squares(4)
    by_cell = sloped(1e6, mesh)
    callable_too = replace(by_cell, kappa=lambda x: np.where(x[:, 0] < 0.5, 1.0, 1e6))
    first, second = (discretise(mesh, 2, each) for each in (by_cell, callable_too))
    np.testing.assert_allclose(first.A.toarray(), second.A.toarray(), atol=1e-12 * abs(first.A).max())
    np.testing.assert_allclose(first.b, second.b, atol=1e-12 * abs(first.b).max())


def test_smooth_kappa_keeps_the_order() -> None:
    """u = x³ + y², κ = 1 + x: κ varies inside the cells, and is integrated where it varies."""
    problem = Diffusion(
        kappa=lambda x: 1 + x[:, 0],
        source=lambda x: -(9 * x[:, 0] ** 2 + 8 * x[:, 0] + 2),
        dirichlet={0: lambda x: x[:, 0] ** 3 + x[:, 1] ** 2},
        exact=lambda x: x[:, 0] ** 3 + x[:, 1] ** 2,
    )
    assert error(agglomerated(36), 3, problem).l2 < 1e-7  # left: faces see κ 1e-7 of their length inside


def tagged(mesh: Mesh) -> Mesh:
    """Boundary faces tagged 1 left, 2 right, 3 elsewhere."""
    x = mesh.points[mesh.face_pairs][:, :, 0]
    tags = np.where((x == 0).all(axis=1), 1, np.where((x == 1).all(axis=1), 2, 3))
    return replace(mesh, face_tags={"boundary": tags})


def test_dirichlet_and_neumann_data_by_tag() -> None:
    """u = x² + y on the square; insulation where no data are given would be wrong above and below."""
    flux = {2: 2.0, 3: lambda x: np.where(x[:, 1] > 0.5, 1.0, -1.0)}
    problem = Diffusion(
        source=-2.0,
        dirichlet={1: lambda x: x[:, 1]},
        neumann=flux,
        exact=lambda x: x[:, 0] ** 2 + x[:, 1],
    )
    for mesh in (samples.voronoi(30, seed=4), agglomerated(12)):
        assert error(tagged(mesh), 2, problem).l2 < 1e-10


def test_faces_without_data_are_insulated() -> None:
    problem = Diffusion(source=0.0, dirichlet={1: 1.0, 2: np.full(16, 3.0)}, exact=lambda x: 1 + 2 * x[:, 0])
    assert error(tagged(samples.squares(4)), 1, problem).l2 < 1e-12


@pytest.mark.parametrize("neumann", [{3: 0.0}, {1: 1.0, 2: -1.0}])
def test_fluxes_alone_must_balance_the_source(neumann: dict[int, float]) -> None:
    with pytest.raises(OptionError, match=r"only up to a constant there, and source and fluxes must balance"):
        discretise(tagged(samples.squares(4)), 2, Diffusion(neumann=neumann))


def test_without_any_data_u_is_zero_on_the_whole_boundary() -> None:
    mesh = tagged(samples.squares(4))
    none, zero = (discretise(mesh, 2, Diffusion(dirichlet=each)) for each in ({}, {1: 0.0, 2: 0.0, 3: 0.0}))
    assert abs(none.A - zero.A).max() == 0.0
    assert (none.b == zero.b).all()


def test_the_load_is_source_and_fluxes_without_dirichlet_data() -> None:
    """u = 5 + 2x + y, κ = 3: ∫ 4 u + ∫ 6 u over the right side + ∫ ±3 u above and below."""
    mesh = tagged(samples.voronoi(30, seed=4))
    flux = {2: 6.0, 3: lambda x: np.where(x[:, 1] > 0.5, 3.0, -3.0)}
    system = discretise(mesh, 1, held := Diffusion(3.0, 4.0, {1: lambda x: 5 + x[:, 1]}, flux))
    basis = Basis(mesh, 1)
    u = basis.project(lambda x: 5 + 2 * x[:, 0] + x[:, 1])
    assert load(basis, held) @ u == pytest.approx(4 * 6.5 + 6 * 7.5 + 3 * (7 - 6))
    assert system.b @ u != pytest.approx(load(basis, held) @ u, rel=0.1)


@pytest.mark.parametrize("kappa", [2.0, np.arange(1.0, 31.0), lambda x: 1 + x[:, 0]])
def test_means_in_cells(kappa: object) -> None:
    mesh = samples.voronoi(30, seed=4)
    wanted = kappa(mesh.cell_centroids) if callable(kappa) else np.broadcast_to(kappa, 30)
    np.testing.assert_allclose(cell_means(mesh, kappa), wanted)


@pytest.mark.parametrize("shift", [0.0, 1e5])
def test_far_from_the_origin_nothing_is_lost(shift: float) -> None:
    near = samples.voronoi(30, seed=3)
    mesh = replace(near, points=near.points + shift)
    found = discretise(mesh, 3, Diffusion()).A.toarray()
    wanted = discretise(near, 3, Diffusion()).A.toarray()
    np.testing.assert_allclose(found, wanted, atol=1e-8 * abs(wanted).max())


BAD: dict[str, tuple[dict[str, object], type[AggloError], str]] = {
    "p = 2.5": ({"degree": 2.5}, OptionError, "1..6; given 2.5"),
    "p = 2.0": ({"degree": 2.0}, OptionError, "1..6; given 2.0"),
    "p = 0": ({"degree": 0}, OptionError, "1..6; given 0"),
    "p = 9": ({"degree": 9}, OptionError, "1..6; given 9"),
    "negative kappa": ({"kappa": -1.0}, OptionError, "kappa must be positive: it is -1.0 in cell 0"),
    "kappa with NaN": (
        {"kappa": np.array([1, 1, np.nan, 1])},
        OptionError,
        "kappa must be finite: it is nan in cell 2",
    ),
    "infinite kappa": ({"kappa": float("inf")}, OptionError, "kappa must be finite: it is inf$"),
    "negative callable": ({"kappa": lambda x: x[:, 0] - 0.5}, OptionError, "kappa must be positive"),
    "kappa per face": ({"kappa": np.ones(12)}, OptionError, r"kappa has shape \(12,\)"),
    "source with NaN": (
        {"source": lambda x: x[:, 0] * np.nan},
        OptionError,
        r"source must be finite: it is nan at \[",
    ),
    "source with inf": ({"source": float("inf")}, OptionError, "source must be finite: it is inf$"),
    "source of a wrong shape": ({"source": lambda x: x}, OptionError, "source returned shape"),
    "source in words": ({"source": "a"}, OptionError, "source must be a number, .* given 'a'"),
    "kappa that fails": ({"kappa": lambda x: 1 / 0}, OptionError, "kappa failed for .*: ZeroDivisionError"),
    "complex values": (
        {"source": lambda x: 1j * x[:, 0]},
        OptionError,
        "source did not return real .* complex128",
    ),
    "masked values": ({"kappa": lambda x: np.ma.masked_less(x[:, 0], 9)}, OptionError, "kappa .* masked"),
    "values in words": (
        {"source": lambda x: "a"},
        OptionError,
        "source did not return real numbers for .*given <U1",
    ),
    "all Neumann": ({"neumann": {0: 1.0}}, OptionError, "determined only up to a constant"),
    "an unknown tag": ({"dirichlet": {7: 0.0}}, OptionError, r"tag 7; the boundary has the tags \[0\]"),
    "a tag twice": ({"dirichlet": {0: 0.0}, "neumann": {0: 0.0}}, OptionError, "give only one of them"),
    "no penalty": ({"penalty": 0.0}, OptionError, "penalty constant must be positive"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_refused(name: str) -> None:
    given, kind, message = BAD[name]
    data = {key: given[key] for key in ("kappa", "source", "dirichlet", "neumann") if key in given}
    mesh = samples.squares(2)
    with pytest.raises(kind, match=message):
        discretise(mesh, given.get("degree", 2), Diffusion(**data), penalty=given.get("penalty", 10.0))


def test_each_component_needs_a_value() -> None:
    """Two squares apart, values on one of them only."""
    points = [[0, 0], [1, 0], [1, 1], [0, 1], [2, 0], [3, 0], [3, 1], [2, 1]]
    mesh = Mesh.from_polygons(points, [[0, 1, 2, 3], [4, 5, 6, 7]])
    mesh = replace(mesh, face_tags={"boundary": mesh.face_cells[:, 0]})
    with pytest.raises(OptionError, match="component of cell 1"):
        discretise(mesh, 1, Diffusion(dirichlet={0: 0.0}))


@pytest.mark.parametrize(
    ("wrong", "place"),
    [
        (Diffusion(exact=lambda x: 1.0 + 0.0 * x[:, 0]), "it is 1, the data are 0"),
        (Diffusion(dirichlet={0: 2.0}, exact=lambda x: 2.0 + sine(x + 0.1)), "the data are 2"),
        (Diffusion(dirichlet={0: lambda x: x[:, 0]}, exact=lambda x: x[:, 1]), "it is"),
    ],
)
@pytest.mark.parametrize("solver", ["polydg_mg", "direct", "polydg_cg", "polydg_mg_paper"])
def test_an_exact_solution_that_contradicts_the_boundary_data_is_refused(
    solver: str, wrong: Diffusion, place: str
) -> None:
    hierarchy = agglomerate(samples.squares(4), n_parts=(4, 2))
    with pytest.raises(OptionError, match=rf"exact contradicts the Dirichlet data: at the .*{place}"):
        agglo.solve(hierarchy, wrong, solver)


@pytest.mark.parametrize("size", [1e-300, 1.0, 1e300])
def test_rounding_and_averages_do_not_contradict_an_exact_solution(size: float) -> None:
    """Values that nearly vanish on the boundary, far coordinates, one value per cell, and fluxes."""
    square = samples.squares(4)
    far = replace(square, points=square.points + 1e6)
    sides = square.with_face_tags(boundary=lambda x: np.isclose(x[:, 0], 0.0))
    PolyDG().check(Diffusion(exact=lambda x: size * sine(x)), square)
    PolyDG().check(Diffusion(exact=lambda x: size * sine(x)), far)
    ramp = lambda x: size * x[:, 0]  # noqa: E731
    PolyDG().check(Diffusion(dirichlet={0: ramp(square.cell_centroids)}, exact=ramp), square)
    PolyDG().check(Diffusion(dirichlet={1: 0.0}, neumann={0: 5.0}, exact=ramp), sides)
    with pytest.raises(OptionError, match="exact contradicts"):
        PolyDG().check(Diffusion(dirichlet={0: 0.0}, neumann={1: 5.0}, exact=ramp), sides)
