"""Laws for an estimator: a number for each cell, near the true error, for any numbering."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agglo_core.arrays import Float
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import require
from agglo_core.conformance.inputs.drawn import DrawnMesh
from agglo_core.conformance.inputs.mesh_cases import solved
from agglo_core.conformance.inputs.questions import answer, as_array, in_words, questions
from agglo_core.conformance.inputs.solver_cases import boundary_tags
from agglo_core.mesh import Mesh
from agglo_core.problems import Diffusion, Solution

_ROUNDING = 1e-6  # of the energy of a solution that is exact
_SMALLEST, _LARGEST = 0.3, 30.0  # effectivity indices: estimate over error


def _takes_diffusion(subject: Subject) -> bool:
    return Diffusion.kind in subject.build().accepts


def _meshes(subject: Subject) -> list[Mesh]:
    """Return 2-D meshes of several kinds, and a 3-D mesh if the estimator supports it."""
    plane = [DrawnMesh(cells=36, jitter=0.25).mesh, DrawnMesh("triangles", cells=60, jitter=0.25).mesh]
    return plane + ([DrawnMesh("boxes", cells=27).mesh] if subject.promised("3d") else [])


@law("estimator", fixed=questions)
def one_per_cell(subject: Subject, case: Case) -> None:
    """``indicate`` returns a finite number for each cell, not negative, and some of them are positive."""
    values, cells = as_array(answer(subject, subject.build(), case)), case.given[0].mesh.n_cells
    require(
        values.shape == (cells,) and values.dtype.kind == "f",
        f"indicate returned {in_words(values)}, expected {cells} numbers",
    )
    require(
        bool(np.isfinite(values).all() and values.min() >= 0.0),
        f"the indicators lie in {values.min()}..{values.max()}, expected finite numbers that are not "
        "negative: take the root of each sum of squares",
    )
    require(cells == 1 or values.max() > 0.0, "all indicators are 0, the error is not")


@law("estimator", when=_takes_diffusion)
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


@law("estimator", when=_takes_diffusion)
def zero_for_exact(subject: Subject) -> None:
    """The estimate of a solution that is exact is 0, except for rounding."""
    for mesh in _meshes(subject):
        solution = _solved_for(_linear, 0.0, mesh)
        estimate, energy = _size(subject.build().indicate(solution)), np.sqrt(mesh.cell_measures.sum())
        require(
            estimate <= _ROUNDING * energy,
            f"on {mesh.name}: the estimate of the exact solution x + 2y is {estimate:.1e}: compare values on "
            "the boundary with the Dirichlet data, and jumps with the neighbour",
        )


@law("estimator", when=_takes_diffusion)
def near_the_error(subject: Subject) -> None:
    """For smooth solutions the estimate is between 0.3 and 30 times the error in the DG norm."""
    for mesh in _meshes(subject):
        for kappa in (1.0, 1e3):
            solution = _solved_for(_smooth, _smooth_source, mesh, kappa)
            error, estimate = solution.errors()["dg"], _size(subject.build().indicate(solution))
            require(
                _SMALLEST <= estimate / error <= _LARGEST,
                f"on {mesh.name}: with kappa {kappa:g} the estimate of u = sin(2x) exp(y) is {estimate:.2g}, "
                f"the error {error:.2g}: expected {_SMALLEST} to {_LARGEST} times the error, in the norm "
                "with the root of kappa",
            )


def _size(indicators: Float) -> float:
    return float(np.linalg.norm(as_array(indicators)))


def _solved_for(exact: object, source: object, mesh: Mesh, kappa: float = 1.0) -> Solution:
    """Solve for an exact solution with Dirichlet data on the whole boundary."""
    data = dict.fromkeys(boundary_tags(mesh), exact)
    right = (lambda x: kappa * source(x)) if callable(source) else source
    return solved(Diffusion(kappa, right, data, exact=exact), mesh)  # type: ignore[arg-type]


def _linear(x: Float) -> Float:
    return np.asarray(x[:, 0] + 2.0 * x[:, 1])


def _smooth(x: Float) -> Float:
    return np.asarray(np.sin(2.0 * x[:, 0]) * np.exp(x[:, 1]))


def _smooth_source(x: Float) -> Float:
    return 3.0 * _smooth(x)
