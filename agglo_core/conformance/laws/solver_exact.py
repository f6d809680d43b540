"""Laws for diffusion solvers: known solutions, and properties of the equation.

A solver may refuse boundary data with an AggloError. Values are compared if the meaning of the unknowns is
known: from the solver's discretisation, or because there is one unknown per cell.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from agglo_core.arrays import Float
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import require
from agglo_core.conformance.inputs.mesh_changes import Change
from agglo_core.conformance.inputs.solver_answers import (
    first_case,
    gap,
    solve_unless_refused,
    values,
)
from agglo_core.conformance.inputs.solver_cases import (
    CORNER,
    SIDES,
    block,
    halves,
    plate,
    transform_hierarchy,
)
from agglo_core.hierarchy import Hierarchy
from agglo_core.problems import Diffusion

_CLOSE = 1e-3  # relative to the largest value; solvers stop at a tolerance of their own
_LEFT, _RIGHT, _BOTTOM, _TOP = SIDES
_CHANGES = {
    "shifted by a million diameters": Change(away=1e6),
    "scaled by 1000": Change(scale=1e3),
    "scaled by 0.001": Change(scale=1e-3),
    "renumbered": None,
}


def _takes_diffusion(subject: Subject) -> bool:
    return bool(first_case(subject, Diffusion))


def _unknowns(subject: Subject, problem: Diffusion, hierarchy: Hierarchy) -> Float | None:
    it = solve_unless_refused(subject, "a plate", problem, hierarchy)
    return None if it is None else it.x


def _unknowns_of_one(subject: Subject, hierarchy: Hierarchy, boundary: str = "boundary") -> Float | None:
    """Return the vector of unknowns whose exact solution is the constant 1, or None if refused."""
    problem = Diffusion(source=0.0, dirichlet=dict.fromkeys(SIDES, 1.0), boundary=boundary)
    return _unknowns(subject, problem, hierarchy)


@law("solver", when=_takes_diffusion)
def constant_found(subject: Subject) -> None:
    """Without source and with boundary value 1 wherever given, the solution is 1 for any κ."""
    hierarchy = plate()
    constant = _unknowns_of_one(subject, hierarchy)
    if constant is None:
        return
    # Other boundary data with the solution 1.
    jump = halves(hierarchy, 1.0, 50.0)
    alike = {
        "with a coefficient that jumps": Diffusion(jump, 0.0, dict.fromkeys(SIDES, 1.0)),
        "given on one side, the others insulated": Diffusion(1.0, 0.0, {_LEFT: 1.0}),
        "given on two sides, flux 0 on the others": Diffusion(
            jump, 0.0, {_RIGHT: 1.0, _TOP: 1.0}, {_LEFT: 0.0, _BOTTOM: 0.0}
        ),
    }
    for name, problem in alike.items():
        x = _unknowns(subject, problem, hierarchy)
        error = 0.0 if x is None else gap(x, constant)
        require(
            error <= _CLOSE,
            f"boundary value 1, {name}: x is off by {error:.1e} from that with value 1 on the whole "
            "boundary: faces whose tag is in neither dirichlet nor neumann are insulated, and κ must not "
            "scale boundary values",
        )
    if samples := values(subject.build(), hierarchy, constant, constant):
        error = np.abs(samples[1] - 1.0).max()
        require(error <= _CLOSE, f"boundary value 1: the solution is off by {error:.1e} from 1")


@law("solver", when=_takes_diffusion)
def linear_found(subject: Subject) -> None:
    """On rectangles a linear function given on the whole boundary is reproduced exactly."""
    hierarchy = plate(tag="edge")

    def plane(points: Float) -> Float:
        return np.asarray(0.3 + points @ np.array([1.0, -2.0]))

    problem = Diffusion(2.0, 0.0, dict.fromkeys(SIDES, plane), boundary="edge")
    _require_found(
        subject, hierarchy, problem, plane, "a linear function as boundary values (face tag 'edge')",
        "measure the distance to the boundary from the cell centre to the face",
    )  # fmt: skip


@law("solver", promise="3d", when=_takes_diffusion)
def found_in_space(subject: Subject) -> None:
    """In 3-D too a linear function is reproduced, from Dirichlet data or from a value and a flux."""
    hierarchy = block()

    def plane(points: Float) -> Float:
        return np.asarray(0.3 + points @ np.array([1.0, -2.0, 3.0]))

    for problem, exact in (
        (Diffusion(2.0, 0.0, dict.fromkeys(range(1, 7), plane)), plane),
        (Diffusion(4.0, 0.0, {5: 1.0}, {6: 3.0}), lambda points: 1.0 + 0.75 * points[:, 2]),
    ):
        _require_found(
            subject, hierarchy, problem, exact, "on a block of boxes, a linear function",
            "faces are areas in 3-D: take them and distances from the mesh, along z too",
        )  # fmt: skip


@law("solver", when=_takes_diffusion)
def flux_found(subject: Subject) -> None:
    """An outward flux q with constant coefficient κ gives the slope q / κ."""
    remedy = "Neumann data are κ ∂u/∂n, outward: they enter as the integral of q over the face, not times κ"
    problem = Diffusion(4.0, 0.0, {_LEFT: 1.0}, {_RIGHT: 3.0})
    _require_found(
        subject, plate(), problem, lambda points: 1.0 + 0.75 * points[:, 0],
        "with value 1 on the left, flux 3 on the right and κ = 4", remedy,
    )  # fmt: skip

    # A cell in a corner may have two faces of one tag.
    def plane(points: Float) -> Float:
        return np.asarray(1.0 + 0.75 * points.sum(axis=1))

    problem = Diffusion(4.0, 0.0, {_LEFT: plane, _BOTTOM: plane}, {_RIGHT: 3.0})
    _require_found(
        subject, plate(tags=CORNER), problem, plane,
        "with flux 3 on two sides of one tag that meet in a corner", f"{remedy}, and add up in a corner cell",
    )  # fmt: skip


@law("solver", when=_takes_diffusion)
def jump_found(subject: Subject) -> None:
    """At a jump of κ along a line of faces, the flux is continuous and the solution piecewise linear."""
    hierarchy = plate()
    for kappa_left, kappa_right in ((1.0, 50.0), (50.0, 1.0)):
        flux = 5.0 / (1.0 / kappa_left + 1.0 / kappa_right)

        def kappa(points: Float, kappa_left: float = kappa_left, kappa_right: float = kappa_right) -> Float:
            return np.where(points[:, 0] < 1.0, kappa_left, kappa_right)

        def exact(
            points: Float, kappa_left: float = kappa_left, kappa_right: float = kappa_right, q: float = flux
        ) -> Float:
            x = points[:, 0]
            return 1.0 + np.where(x < 1.0, q * x / kappa_left, q / kappa_left + q * (x - 1.0) / kappa_right)

        for form in (kappa, halves(hierarchy, kappa_left, kappa_right)):
            problem = Diffusion(form, 0.0, {_LEFT: 1.0, _RIGHT: 6.0})
            _require_found(
                subject, hierarchy, problem, exact,
                f"κ = {kappa_left:g} left and {kappa_right:g} right "
                f"({'a callable' if callable(form) else 'by cell'})",
                "between two cells resistances (distance over κ) add up: take the harmonic mean of κ",
            )  # fmt: skip


@law("solver", when=_takes_diffusion)
def finer_is_closer(subject: Subject) -> None:
    """For a smooth solution with a source, halving the cell size divides the error by 2.5 or more."""
    kappa = 3.0

    def exact(points: Float) -> Float:
        x, y = points.T
        return np.asarray(np.sin(np.pi * x / 2) * np.sin(np.pi * y))

    problem = Diffusion(kappa, lambda points: 1.25 * np.pi**2 * kappa * exact(points))
    errors = []
    for n in (6, 12):
        hierarchy = plate(n, n)
        samples = _sample_solution(subject, hierarchy, problem)
        if samples is None:
            return
        points, u = samples
        errors.append(float(np.abs(u - exact(points)).max()))
    require(
        errors[1] <= max(0.4 * errors[0], 1e-4) and errors[0] < 0.5,
        f"for u = sin(πx/2) sin(πy) the largest error is {errors[0]:.2e} with 6 by 6 cells and "
        f"{errors[1]:.2e} with 12 by 12: the source is integrated over cells, at their centroids or by "
        "quadrature, and fluxes over faces",
    )


@law("solver", when=_takes_diffusion)
def data_superposed(subject: Subject) -> None:
    """The solution for source, boundary values and fluxes together is the sum of the separate solutions."""
    hierarchy = plate()
    kappa = halves(hierarchy, 1.0, 5.0)
    data = {
        "source": Diffusion(kappa, 2.0, {_LEFT: 0.0}, {_TOP: 0.0}),
        "boundary value": Diffusion(kappa, 0.0, {_LEFT: lambda p: 1.0 + p[:, 1]}, {_TOP: 0.0}),
        "flux": Diffusion(kappa, 0.0, {_LEFT: 0.0}, {_TOP: lambda p: p[:, 0] - 0.5}),
    }
    together = replace(
        data["source"], dirichlet=data["boundary value"].dirichlet, neumann=data["flux"].neumann
    )
    x, *parts = (_unknowns(subject, problem, hierarchy) for problem in (together, *data.values()))
    valid_parts = [part for part in parts if part is not None]
    if x is not None and len(valid_parts) == len(parts):
        error = gap(x, np.sum(valid_parts, axis=0))
        require(
            error <= _CLOSE,
            "source, boundary value and flux together give an x that differs from the sum of the single "
            f"solutions by {error:.1e}: check whether one of them disables another",
        )


@law("solver", when=_takes_diffusion)
def place_and_size(subject: Subject) -> None:
    """Position and numbering of the mesh do not matter, and scaling by s scales the solution by s²."""
    hierarchy = plate()
    kappa = halves(hierarchy, 1.0, 5.0)
    before = _sample_solution(subject, hierarchy, Diffusion(kappa, 2.0))
    if before is None:
        return
    for name, change in _CHANGES.items():
        changed_hierarchy, order = transform_hierarchy(hierarchy, change)
        scale = change.scale if change else 1.0
        after = _sample_solution(subject, changed_hierarchy, Diffusion(kappa[order], 2.0))
        if after is not None:
            error = gap(after[1] / scale**2, before[1][order])
            require(
                error <= _CLOSE,
                f"on a plate {name}: the solution is off by {error:.1e}: take areas and distances from the "
                "mesh; mesh.local_points and mesh.local_centroids keep digits far from 0",
            )


def _sample_solution(
    subject: Subject, hierarchy: Hierarchy, problem: Diffusion
) -> tuple[Float, Float] | None:
    """Return points and solution values there, or None if refused or if x cannot be evaluated."""
    constant = _unknowns_of_one(subject, hierarchy, problem.boundary)
    x = _unknowns(subject, problem, hierarchy)
    require(
        constant is None or np.any(constant != 0.0),
        f"boundary value 1 everywhere (face tag {problem.boundary!r}) gives x = 0: check that boundary data "
        "are read",
    )
    return None if x is None else values(subject.build(), hierarchy, x, constant)


def _require_found(
    subject: Subject,
    hierarchy: Hierarchy,
    problem: Diffusion,
    exact: Callable[[Float], Float],
    description: str,
    remedy: str,
) -> None:
    samples = _sample_solution(subject, hierarchy, problem)
    if samples is not None:
        points, u = samples
        expected = exact(points)
        error = float(np.abs(u - expected).max() / np.abs(expected).max())
        worst = int(np.abs(u - expected).argmax())
        require(
            error <= _CLOSE,
            f"{description}: at {points[worst]} the solution is {u[worst]:.4g}, expected "
            f"{expected[worst]:.4g}: {remedy}",
        )
