"""Laws for error estimates by cell: of an estimator, or by the residuals of a discretisation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from agglo_core.arrays import Float
from agglo_core.conformance.base import Case, Subject, as_array, law, require
from agglo_core.conformance.inputs.drawn import DrawnMesh
from agglo_core.conformance.inputs.mesh_cases import solved
from agglo_core.conformance.inputs.questions import plain, questions
from agglo_core.conformance.inputs.solver_answers import takes_diffusion
from agglo_core.conformance.inputs.solver_cases import boundary_tags
from agglo_core.mesh import Mesh
from agglo_core.problems import Diffusion

_ROUNDING = 1e-6  # of the energy of a solution that is exact
_SMALLEST, _LARGEST = 0.3, 30.0  # effectivity indices: estimate over error


def _estimates(subject: Subject) -> bool:
    """Return True for estimators, and for discretisations with residuals, if they accept diffusion."""
    has_residuals = getattr(subject.build(), "residuals", None) is not None
    return takes_diffusion(subject) and (subject.kind == "estimator" or has_residuals)


def _meshes(subject: Subject) -> list[Mesh]:
    """Return 2-D meshes of several kinds, and a 3-D mesh if the component supports it."""
    plane = [DrawnMesh(cells=36, jitter=0.25).mesh, DrawnMesh("triangles", cells=60, jitter=0.25).mesh]
    return plane + ([DrawnMesh("boxes", cells=27).mesh] if subject.promised("3d") else [])


@law("estimator", fixed=questions)
def one_per_cell(subject: Subject, case: Case) -> None:
    """``indicate`` returns finite numbers, not negative, and some of them are positive."""
    values = plain(subject, case)
    require(
        bool(np.isfinite(values).all() and values.min() >= 0.0),
        f"the indicators lie in {values.min()}..{values.max()}, expected finite numbers that are not "
        "negative: take the root of each sum of squares",
    )
    require(len(values) == 1 or values.max() > 0.0, "all indicators are 0, the error is not")


@law("estimator", when=_estimates)
def follows_numbering(subject: Subject) -> None:
    """On a mesh with other cell numbers the indicators are those of the cells."""
    for mesh in _meshes(subject):
        number = np.random.default_rng(3).permutation(mesh.n_cells)
        other = replace(mesh, face_cells=np.append(number, -1)[mesh.face_cells])
        problem = Diffusion(source=lambda x: np.exp(x[:, 0]))
        values, moved = (as_array(subject.build().indicate(solved(problem, on))) for on in (mesh, other))
        gap = float(np.abs(moved[number] - values).max())
        require(
            gap <= _ROUNDING * values.max(),
            f"on {mesh.name}: renumbered cells change an indicator by {gap:.1e}, the largest is "
            f"{values.max():.1e}: share the terms of a face between both of its cells",
        )


@law("estimator", "discretisation", when=_estimates)
def zero_for_exact(subject: Subject) -> None:
    """The estimate, or the sum of ``residuals``, of a solution that is exact is 0, except for rounding."""
    for mesh in _meshes(subject):
        estimate, _ = _estimate(subject, mesh, 1.0, lambda x: x[:, 0] + 2.0 * x[:, 1], 0.0)
        require(
            estimate <= _ROUNDING * np.sqrt(mesh.cell_measures.sum()),
            f"on {mesh.name}: the estimate of the exact solution x + 2y is {estimate:.1e}: compare values on "
            "the boundary with the Dirichlet data, and jumps with the neighbour",
        )


@law("estimator", "discretisation", when=_estimates)
def near_the_error(subject: Subject) -> None:
    """The estimate, or root of summed ``residuals``, is 0.3 to 30 times the error in the energy norm."""
    for mesh in _meshes(subject):
        for kappa in (1.0, 1e3):
            estimate, error = _estimate(subject, mesh, kappa, _smooth, 3.0 * kappa)
            require(
                error is None or _SMALLEST <= estimate / error <= _LARGEST,
                f"on {mesh.name}: with kappa {kappa:g} the estimate of u = sin(2x) exp(y) is {estimate:.2g}, "
                f"the error {error}: expected {_SMALLEST} to {_LARGEST} times the error, in the norm with "
                "the root of kappa",
            )


def _estimate(
    subject: Subject, mesh: Mesh, kappa: float, exact: Callable[[Float], Float], factor: float
) -> tuple[float, float | None]:
    """Solve with Dirichlet data, and return the estimate and, if it is known, the error in its norm.

    The source is the exact solution times ``factor``.
    """
    tool, data = subject.build(), dict.fromkeys(boundary_tags(mesh), exact)
    problem = Diffusion(kappa, lambda x: factor * exact(x), data, exact=exact)
    if subject.kind == "estimator":
        solution = solved(problem, mesh)
        return float(np.linalg.norm(as_array(tool.indicate(solution)))), solution.errors()["dg"]
    system = tool.assemble(problem, mesh)
    x = np.atleast_1d(spsolve(sparse.csc_array(system.A), system.b))
    squares, errors = tool.residuals(problem, mesh, x), tool.errors(problem, mesh, x)
    for name, values in squares.items():
        require(
            np.shape(values) == (mesh.n_cells,) and np.isfinite(values).all() and np.min(values) >= 0.0,
            f"on {mesh.name}: the residuals {name!r} are not {mesh.n_cells} squares for the cells",
        )
    total = sum(values.sum() for name, values in squares.items() if name != "oscillation")
    return float(np.sqrt(total)), errors.get("dg", errors.get("energy"))


def _smooth(x: Float) -> Float:
    return np.asarray(np.sin(2.0 * x[:, 0]) * np.exp(x[:, 1]))
