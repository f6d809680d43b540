"""Nonlinear stationary problems by Newton's method, as sequences of linear problems."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from agglo_core.arrays import Float, frozen_float
from agglo_core.errors import AggloError, OptionError
from agglo_core.hierarchy import Hierarchy
from agglo_core.mesh import Mesh
from agglo_core.problems.diffusion import Diffusion
from agglo_core.problems.discretisation import Field
from agglo_core.problems.residuals.sizes import size_ratio, two_norm
from agglo_core.problems.solution import Solution
from agglo_core.problems.solving import hierarchy_of, initial_unknowns, solver_member
from agglo_core.registry import Registry
from agglo_core.registry.attribution import attributed
from agglo_core.registry.containment import shown
from agglo_core.suggestions import suggest_keywords


@suggest_keywords()
def newton(
    on: Mesh | Hierarchy,
    linearised: Callable[[Callable[[Float], Float]], Diffusion],
    u0: Field | Solution = 0.0,
    *,
    change: float = 1e-5,
    max_steps: int = 20,
    solver: str | tuple[str, Mapping[str, Any]] | Any = "polydg_mg",
    registry: Registry | None = None,
    **options: Any,
) -> Solution:
    """Solve a nonlinear problem by Newton's method: each step solves the problem linearised at the last u.

    For −∇·(κ∇u) + c(u) = f with c' ≥ 0 the linearised problem has the reaction c'(u) and the source
    f + c'(u) u − c(u). A problem that only freezes a coefficient, as κ(u), gives a fixed-point iteration,
    which converges linearly. Multigrid levels and earlier solutions are reused.

    Parameters
    ----------
    on : Mesh or Hierarchy
    linearised : callable
        Maps u, a function of points ``(q, d)``, to the linear problem whose solution is the next u.
    u0 : Field or Solution
        Initial values.
    change : float
        Bound on the last change of u, relative to u in the L2 norm. Newton's method is then far more
        accurate than this bound, but not than the solver's ``tolerance``.
    max_steps : int
    solver, registry, **options
        As for :func:`solve`. The solver must have ``repeated(hierarchy)``, as ``polydg_mg`` and ``direct``
        have.

    Returns
    -------
    Solution
        Solution of the last linear problem.

    Raises
    ------
    OptionError
        For invalid arguments, a linear problem that is not solved, or if ``max_steps`` do not suffice: with
        the last change, and the residual of the nonlinear problem before the last step.

    Examples
    --------
    >>> def linearised(u):  # −Δu + u³ = 8
    ...     return agglo.Diffusion(
    ...         reaction=lambda x: 3.0 * u(x) ** 2, source=lambda x: 8.0 + 2.0 * u(x) ** 3
    ...     )
    >>> agglo.newton(agglo.samples.squares(8), linearised, degree=2).evaluate([[0.5, 0.5]]).round(2)
    array([0.58])
    """
    # 1. Check the arguments
    if not callable(linearised):
        raise OptionError(
            f"linearised must be a function of u that returns a Diffusion, given {shown(linearised)}"
        )
    if not 0.0 < change < 1.0:
        raise OptionError(f"change must lie between 0 and 1, given {change!r}")
    if max_steps < 1:
        raise OptionError(f"max_steps must be at least 1, given {max_steps!r}")
    hierarchy = hierarchy_of(on, "newton")
    mesh, member = hierarchy.fine, solver_member(solver, options, registry, newton)
    how: Any = getattr(member.tool, "discretisation", None)
    if mesh is None or not hasattr(how, "mass") or not hasattr(member.tool, "repeated"):
        raise OptionError(
            "newton requires a mesh, and a solver with repeated(hierarchy) and a discretisation with mass; "
            f"given {member.title}"
        )
    # 2. Solve linearised problems
    mass = how.mass(mesh)
    x = initial_unknowns(u0, how, mesh, mass.shape[0])
    with attributed(member.title, spare=(AggloError,)):
        steps = member.tool.repeated(hierarchy)
    for step in range(max_steps):
        problem = linearised(partial(how.evaluate, mesh, frozen_float(x)))
        if not isinstance(problem, Diffusion):
            raise OptionError(f"linearised must return a Diffusion, returned {shown(problem)}")
        with attributed(member.title, spare=(AggloError,)):
            solution: Solution = steps.solve(problem)
        if not (solution.converged or solution.rounding_limited):
            raise OptionError(f"the linear problem of step {step + 1} was not solved: {solution.reason}")
        # 3. Test the change
        residual = size_ratio(two_norm(solution.b - solution.A @ x), two_norm(solution.b))
        difference, x = solution.x - x, solution.x
        last = math.sqrt(size_ratio(difference @ (mass @ difference), x @ (mass @ x)))
        if last <= change:
            return solution
    raise OptionError(
        f"newton did not converge in {max_steps} steps: the last changed u by {last:.1e} of its norm, "
        f"required {change:.1e}; before it the relative residual was {residual:.1e}; "
        "start closer to the solution"
    )
