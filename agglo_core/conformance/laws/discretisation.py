"""Laws for a discretisation: its systems, its functions, and its solutions of diffusion problems."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from agglo_core.arrays import Float
from agglo_core.conformance.base import (
    Case,
    Subject,
    as_array,
    in_words,
    law,
    require,
    require_array,
    require_close,
)
from agglo_core.conformance.inputs.drawn import drawn_labels
from agglo_core.conformance.inputs.questions import answer
from agglo_core.conformance.inputs.solver_answers import assemble, solve_assembled, takes_diffusion
from agglo_core.conformance.inputs.solver_cases import boundary_tags
from agglo_core.conformance.inputs.strategies import mesh_cases
from agglo_core.problems import Diffusion, Samples, System

_STEP = 1e-2  # of the differences that verify gradients, relative to a simplex
_METHODS = ("check", "coarse_operator", "project", "evaluate", "sample", "errors", "load", "residual_measure")
_FLAT = 1e-6  # measure of a simplex, relative to that of its cell, below which it is not tested
_EXAMPLES = 30  # drawn meshes for each law
_INWARD = 1e-5  # from the corners of a simplex towards its centre, relative to the distance
_ROUNDING = 1e-8  # relative error of a solution that is exact


def _offers(method: str) -> Callable[[Subject], bool]:
    """Return a condition of laws for an optional method."""
    return lambda subject: getattr(subject.build(), method, None) is not None


@law("discretisation")
def has_all_methods(subject: Subject) -> None:
    """Every method of the protocol exists, and ``accepts`` contains names of problem kinds."""
    tool = subject.build()
    missing = [name for name in _METHODS if not callable(getattr(tool, name, None))]
    require(not missing, f"it has no method {', '.join(missing)}: see agglo_core.problems.Discretisation")
    kinds = tool.accepts
    require(
        bool(kinds) and all(isinstance(kind, str) for kind in kinds),
        f"accepts is {kinds!r}, expected names of kinds of problem, such as ('diffusion',)",
    )


@law("discretisation", draw=mesh_cases, examples=_EXAMPLES)
def system_fits_mesh(subject: Subject, case: Case) -> None:
    """``assemble`` returns a System whose blocks are the cells of the mesh, if it names the mesh."""
    system, cells = answer(subject, case), case.given[1].n_cells
    require(
        isinstance(system, System),
        f"assemble returned {in_words(system)}, expected a System(A, b, block_offsets)",
    )
    require(
        system.mesh is None or system.n_blocks == cells,
        f"the system has {system.n_blocks} blocks, the mesh {cells} cells: block c of block_offsets holds "
        "the unknowns of cell c; for unknowns at vertices or faces, leave out the mesh",
    )


@law("discretisation", draw=mesh_cases, examples=_EXAMPLES)
def constants_kept(subject: Subject, case: Case) -> None:
    """The projection of a constant is this constant, by ``evaluate`` and by ``sample``."""
    tool, mesh = subject.build(), case.given[1]
    projected = tool.project(mesh, lambda points: np.full(len(points), 3.0))
    x = require_array(projected, (answer(subject, case, tool).n,), "f", what="project")
    samples = tool.sample(mesh, x)
    require(isinstance(samples, Samples), f"sample returned {in_words(samples)}, expected Samples")
    evaluated: Any = as_array(tool.evaluate(mesh, x, mesh.cell_centroids))
    for method, values, size in (
        ("evaluate", evaluated, mesh.n_cells),
        ("sample", samples.values, len(samples.cells)),
    ):
        require(
            values.shape in ((size,), (size, mesh.dim)) and bool(np.allclose(values, 3.0, rtol=1e-8)),
            f"{method} of the projection of 3 is {in_words(values)}, expected 3 at all points",
        )


def _simplex_sizes(samples: Samples) -> Float:
    """Return the area or volume of each simplex ``(t,)``."""
    corners = samples.points[samples.simplices]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    return np.asarray(volumes / (2.0 if corners.shape[2] == 2 else 6.0))


@law("discretisation", draw=mesh_cases, examples=_EXAMPLES)
def samples_fill_cells(subject: Subject, case: Case) -> None:
    """The simplices of ``sample`` fill each cell, with values as by ``evaluate``, which is NaN outside."""
    tool, mesh = subject.build(), case.given[1]
    x = as_array(tool.project(mesh, 1.0))
    samples = tool.sample(mesh, x)
    sizes = _simplex_sizes(samples)
    found = np.bincount(samples.cells[samples.simplices[:, 0]], sizes, mesh.n_cells)
    require_close(
        found / mesh.cell_measures,
        np.ones(mesh.n_cells),
        1e-6,
        "the measure of simplices over that of a cell",
    )
    # Values just inside the corners of the simplices, for random unknowns.
    x = np.random.default_rng(5).uniform(-1.0, 1.0, len(x))
    samples = tool.sample(mesh, x)
    simplices = samples.simplices[sizes > 1e-9 * mesh.cell_measures.max()]
    corners = samples.points[simplices]
    inside = corners + _INWARD * (corners.mean(axis=1, keepdims=True) - corners)
    values = samples.values[simplices.ravel()]
    gaps = np.abs(tool.evaluate(mesh, x, inside.reshape(-1, mesh.dim)) - values)
    gaps = gaps.reshape(len(values), -1).max(axis=1)  # largest component of vectors
    worst = int(np.nanargmax(gaps))
    require(
        gaps[worst] <= 1e-2 * np.abs(samples.values).max(),
        f"evaluate and sample differ by {gaps[worst]:.2g} in cell "
        f"{samples.cells[simplices.ravel()[worst]]}: find the cell that contains a point, not the one with "
        "the nearest centroid",
    )
    beyond = mesh.points.max(axis=0) + np.ptp(mesh.points, axis=0)
    value = as_array(tool.evaluate(mesh, x, beyond[None]))
    require(
        value.shape in ((1,), (1, mesh.dim)) and bool(np.isnan(value).all()),
        f"evaluate gives {value} at a point outside the mesh, expected NaN",
    )


@law("discretisation", draw=mesh_cases, examples=_EXAMPLES, when=takes_diffusion)
def symmetric_and_definite(subject: Subject, case: Case) -> None:
    """The matrix of a diffusion problem is symmetric and positive definite."""
    tool, mesh = subject.build(), case.given[1]
    rough = 10.0 ** np.random.default_rng(1).uniform(-2.0, 2.0, mesh.n_cells)
    system = assemble(tool, Diffusion(rough), mesh)
    if system is None:
        return
    A = sparse.csr_array(system.A).toarray()
    A = A / np.sqrt(np.outer(np.abs(np.diag(A)), np.abs(np.diag(A))))  # independent of units
    require_close(A, A.T, _ROUNDING, "an entry of the matrix, relative to its diagonal,", "it is symmetric")
    least = float(np.linalg.eigvalsh(A)[0])
    require(
        least > 0.0,
        f"the matrix scaled to a diagonal of ones has the eigenvalue {least:.1e}: enlarge the penalty or "
        "stabilisation, with the coefficient of both cells",
    )


@law("discretisation", draw=mesh_cases, examples=_EXAMPLES, promise="patch_test", when=takes_diffusion)
def patch_test(subject: Subject, case: Case) -> None:
    """Linear solutions are met on any mesh, and linear functions are their own projections."""
    tool, mesh = subject.build(), case.given[1]
    low, extent = mesh.points.min(axis=0), np.ptp(mesh.points, axis=0)

    def linear(points: Float) -> Float:
        return np.asarray(1.0 + (points - low) / extent @ np.array([3.0, -2.0, 0.5])[: mesh.dim])

    problem = Diffusion(2.0, 0.0, dict.fromkeys(boundary_tags(mesh), linear))
    exact = linear(mesh.cell_centroids)
    projected = tool.evaluate(mesh, tool.project(mesh, linear), mesh.cell_centroids)
    solution = solve_assembled(tool, problem, mesh)
    for what, values in (("the projection of a linear function", projected), ("a linear solution", solution)):
        if values is not None:  # None for a refused problem, NaN for a centroid in a hole of the mesh
            values = np.where(np.isnan(values), exact, values)
            require_close(values, exact, 1e3 * _ROUNDING, f"{what}, at a centroid,")


@law("discretisation", draw=mesh_cases, examples=_EXAMPLES, when=takes_diffusion)
def coarse_like_fine(subject: Subject, case: Case) -> None:
    """``coarse_operator`` fits the coarse mesh, is symmetric, and for single cells equals the matrix."""
    tool, mesh = subject.build(), case.given[1]
    kappa = 10.0 ** np.random.default_rng(2).uniform(-1.0, 1.0, mesh.n_cells)
    problem = Diffusion(kappa)
    system = assemble(tool, problem, mesh)
    if system is None:
        return
    A = sparse.csr_array(system.A).toarray()
    alone = sparse.csr_array(tool.coarse_operator(problem, mesh, np.arange(mesh.n_cells))).toarray()
    require_close(alone, A, 1e-6, "with one agglomerate per cell, an entry of the coarse operator")
    labels = drawn_labels(mesh.graph, "grown", min(3, mesh.n_cells))
    coarse = sparse.csr_array(tool.coarse_operator(problem, mesh, labels)).toarray()
    n = tool.assemble(Diffusion(), mesh.coarsen(labels)).n
    what = f"on {case.name} in {labels.max() + 1} parts: the coarse operator"
    require_array(coarse, (n, n), "f", "the unknowns of mesh.coarsen(labels)", what)
    require_close(coarse, coarse.T, _ROUNDING, f"{what} is not symmetric: an entry")


@law("discretisation", draw=mesh_cases, examples=_EXAMPLES, when=takes_diffusion)
def errors_measured(subject: Subject, case: Case) -> None:
    """The error ``l2`` of the function 1 is the root of the domain's measure if the solution is 0."""
    tool, mesh = subject.build(), case.given[1]
    problem = Diffusion(source=0.0, exact=lambda points: np.zeros(len(points)))
    norms = tool.errors(problem, mesh, tool.project(mesh, 1.0))
    root = float(np.sqrt(mesh.cell_measures.sum()))
    require_close(norms.get("l2", root), root, 1e-6, "the error l2", "the root of the measure")
    nothing = tool.errors(replace(problem, exact=None), mesh, tool.project(mesh, 1.0))
    require(not nothing, f"without an exact solution errors returned {nothing}, expected {{}}")


@law("discretisation", draw=mesh_cases, examples=_EXAMPLES, when=takes_diffusion)
def load_and_residuals(subject: Subject, case: Case) -> None:
    """``load`` is b without Dirichlet terms, and residuals are measured in a norm, relative to b."""
    tool, mesh = subject.build(), case.given[1]
    zero, three = (dict.fromkeys(boundary_tags(mesh), value) for value in (0.0, 3.0))
    plain, lifted = Diffusion(source=2.0, dirichlet=zero), Diffusion(source=2.0, dirichlet=three)
    without, system = (assemble(tool, problem, mesh) for problem in (plain, lifted))
    if without is None or system is None:
        return
    expected, b = without.b, system.b
    what = "an entry of the load with boundary value 3"
    require_close(tool.load(lifted, mesh, b), expected, 1e3 * _ROUNDING, what, "b with boundary value 0")
    if not expected.any():  # Dirichlet data fix all unknowns
        return
    measure = tool.residual_measure(plain, mesh, expected)
    r = np.random.default_rng(4).standard_normal(len(expected)) * np.abs(expected).max()
    once, twice, none = (float(measure(factor * r)) for factor in (1.0, 2.0, 0.0))
    require(
        none == 0.0 and once > 0.0 and abs(twice - 2.0 * once) <= _ROUNDING * twice,
        f"the measures of r, 2r and 0 are {once}, {twice} and {none}: expected a norm",
    )


@law("discretisation", draw=mesh_cases, examples=_EXAMPLES, when=_offers("gradient"))
def gradient_fits_values(subject: Subject, case: Case) -> None:
    """``gradient`` is the limit of the differences of ``evaluate``, and NaN outside the mesh."""
    tool, mesh = subject.build(), case.given[1]
    x = as_array(tool.project(mesh, lambda points: np.sin(points.sum(axis=1))))
    samples = tool.sample(mesh, x)
    owners = samples.cells[samples.simplices[:, 0]]
    # The centre of a simplex without area may lie on the border of its cell.
    whole = _simplex_sizes(samples) > _FLAT * mesh.cell_measures[owners]
    corners = samples.points[samples.simplices[whole]]
    centres = corners.mean(axis=1)
    outside = mesh.points.max(axis=0, keepdims=True) + 1.0
    slopes = as_array(tool.gradient(mesh, x, np.concatenate((centres, outside))))
    shape = (len(centres) + 1, *samples.values.shape[1:], mesh.dim)
    require(
        slopes.shape == shape and bool(np.isnan(slopes[-1]).all()),
        f"gradient returned {in_words(slopes)}, expected {shape}, with NaN for the last point, which is "
        "outside the mesh",
    )
    # Differences along short steps towards the corners, which remain in the simplex
    for step in _STEP * np.moveaxis(corners - centres[:, None], 1, 0):
        rise = tool.evaluate(mesh, x, centres + step) - tool.evaluate(mesh, x, centres - step)
        expected = 2.0 * np.einsum("qd,q...d->q...", step, slopes[:-1])
        worst = np.unravel_index(np.argmax(np.abs(rise - expected)), rise.shape)
        require(
            bool(abs(rise[worst] - expected[worst]) <= 1e-2 * np.abs(rise).max() + 1e-9),
            f"a step at {centres[worst[0]].tolist()} alters evaluate by {rise[worst]:.6g}, but gradient "
            f"predicts {expected[worst]:.6g}",
        )


@law("discretisation", draw=mesh_cases, examples=_EXAMPLES, when=_offers("integrals"))
def integrals_fit_values(subject: Subject, case: Case) -> None:
    """``integrals`` over cells are those of the samples of a projected linear function."""
    tool, mesh = subject.build(), case.given[1]
    x = as_array(tool.project(mesh, lambda points: 1.0 + points.sum(axis=1)))
    samples = tool.sample(mesh, x)
    parts = (_simplex_sizes(samples) * samples.values[samples.simplices].mean(axis=1).T).T
    expected = np.zeros((mesh.n_cells, *parts.shape[1:]))
    np.add.at(expected, samples.cells[samples.simplices[:, 0]], parts)
    require_close(tool.integrals(mesh, x), expected, 1e-6, "the integral over a cell")


@law("discretisation", draw=mesh_cases, examples=_EXAMPLES, when=_offers("mass"))
def mass_integrates(subject: Subject, case: Case) -> None:
    """``mass`` is symmetric, and integrates the function 1 to the measures of mesh and cells."""
    tool, mesh = subject.build(), case.given[1]
    system, M = answer(subject, case, tool), tool.mass(mesh)
    n = system.n
    require(getattr(M, "shape", None) == (n, n), f"mass returned {in_words(M)}, expected a matrix ({n}, {n})")
    M = sparse.csr_array(M)
    require(abs(M - M.T).max() <= 1e-10 * abs(M).max(), "the mass matrix is not symmetric")
    one = as_array(tool.project(mesh, 1.0))
    components = np.size(tool.evaluate(mesh, one, mesh.cell_centroids[:1]))
    # Unknowns of a system without mesh belong to no cell.
    cells = [] if system.mesh is None else sorted({0, mesh.n_cells // 2, mesh.n_cells - 1})
    shares = one * (M @ one) / components
    for cell in cells:
        measure = shares[slice(*system.block_offsets[cell : cell + 2])].sum()
        require_close(
            measure, mesh.cell_measures[cell], 1e-8, f"the measure of cell {cell} by the mass matrix"
        )
    require_close(shares.sum(), mesh.cell_measures.sum(), 1e-8, "the measure of the mesh by the mass matrix")


@law("discretisation", draw=mesh_cases, examples=_EXAMPLES, when=_offers("quadrature"))
def quadrature_fits_values(subject: Subject, case: Case) -> None:
    """``quadrature`` has weights that sum to the measure, and the values of ``evaluate`` at its points."""
    tool, mesh = subject.build(), case.given[1]
    points, weights, values = tool.quadrature(mesh)
    x = as_array(tool.project(mesh, lambda points: np.cos(points.sum(axis=1))))
    measure = mesh.cell_measures.sum()
    require_close(
        np.sum(weights), measure, 1e-8, "the sum of the weights of quadrature", "the mesh's measure"
    )
    evaluated = tool.evaluate(mesh, x, points)
    require_close(values @ x, evaluated, 1e-6, "values @ x of quadrature, at a point,", "that of evaluate")


@law(
    "discretisation",
    draw=mesh_cases,
    examples=_EXAMPLES,
    when=lambda subject: _offers("fluxes")(subject) and takes_diffusion(subject),
)
def fluxes_balance_source(subject: Subject, case: Case) -> None:
    """``fluxes`` out of each cell sum to its measure if −Δu = 1 is solved."""
    tool, mesh, problem = subject.build(), case.given[1], Diffusion(source=1.0)
    system = tool.assemble(problem, mesh)
    x = spsolve(sparse.csc_array(system.A), system.b)
    fluxes = require_array(tool.fluxes(problem, mesh, x), (mesh.n_faces,), "f", what="fluxes")
    first, second = mesh.face_cells.T
    inner = second >= 0
    sums = np.bincount(first, fluxes, mesh.n_cells)
    sums -= np.bincount(second[inner], fluxes[inner], mesh.n_cells)
    gap = np.abs(sums - mesh.cell_measures)
    worst = int(np.argmax(gap))
    require(
        bool(gap[worst] <= 1e-6 * max(mesh.cell_measures[worst], np.abs(fluxes).max())),
        f"the fluxes out of cell {worst} sum to {sums[worst]:.6g}, but its source is "
        f"{mesh.cell_measures[worst]:.6g}",
    )
