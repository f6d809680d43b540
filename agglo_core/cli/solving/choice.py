"""Choice of solver, problem and discretisation on the command line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agglo_core.cli.options.specs import as_typed
from agglo_core.errors import AggloError, OptionError, PluginError
from agglo_core.registry import default, describe
from agglo_core.registry.attribution import attributed

if TYPE_CHECKING:
    from agglo_core.mesh import Mesh
    from agglo_core.problems import Discretisation, Problem, System

DEFAULT_SOLVER = "polydg_mg"


@dataclass(frozen=True)
class Posed:
    """Problem on a mesh with the discretisation ``how`` of the solver, if it has one."""

    problem: Problem
    mesh: Mesh
    how: Discretisation | None
    solver: str

    def refuse_without_meaning(self, options: str) -> None:
        """Raise OptionError for options that need a discretisation if the solver has none."""
        if self.how is None:
            raise OptionError(
                f"{self.solver} has no discretisation to interpret the unknowns of problem "
                f"kind {self.problem.kind}: {options} not available"
            )

    def system(self) -> System:
        """Return matrix and right-hand side, from the discretisation or as given by the problem.

        Raises
        ------
        OptionError
            Without a discretisation.
        """
        import numpy as np

        from agglo_core.problems import Linear, System

        if isinstance(self.problem, Linear):
            return System(self.problem.A, self.problem.b, self.problem.block_offsets, self.mesh)
        self.refuse_without_meaning("--write-system is")
        assert self.how is not None
        with attributed(f"the discretisation of {self.solver}", spare=(AggloError,)):
            system = self.how.assemble(self.problem, self.mesh)
            if system.near_null is None:
                constant = self.how.project(self.mesh, lambda points: np.ones(len(points)))
                system = replace(system, near_null=np.asarray(constant)[:, None])
        return system


def solver_title(spec: str) -> str:
    """Return the name of a solver for messages, from its description on the command line."""
    return describe(default().record("solver", as_typed(spec)[0]))


def build_solver(spec: str, given: Mapping[str, Any], flag: str = "--solver") -> Any:
    """Build a solver from a text such as ``"name:option=value"`` and options from separate flags.

    Raises
    ------
    OptionError
        For an unknown option, or an option given twice.
    PluginError
        For an unknown or unusable solver.
    """
    name, options = as_typed(spec)
    duplicates = sorted(set(options) & set(given))
    if duplicates:
        raise OptionError(f"{duplicates[0]} is given twice: in {flag} {spec} and by the separate option")
    try:
        return default().build("solver", name, **options, **given)
    except PluginError as error:
        if name != DEFAULT_SOLVER:
            raise
        raise PluginError(f"{error}; choose another component with {flag}") from error


def pose_problem(text: str, mesh: Mesh, tool: object, solver: str, *, allow_code: bool) -> Posed:
    """Build the problem from its name or file, and check that the solver accepts it.

    Raises
    ------
    OptionError
        If the solver does not accept the problem, and errors of
        :func:`~agglo_core.problems.named_problem` and of the discretisation.
    """
    from agglo_core.problems import discretisation_of, named_problem, require_accepted

    if not text:
        raise OptionError("--problem is empty; expected a problem name or a TOML file")
    is_file = Path(text).suffix.lower() == ".toml" or Path(text).exists()
    name, options = (text, {}) if is_file else as_typed(text)
    problem = named_problem(name, mesh, options, allow_code=allow_code)
    require_accepted(tool, problem, solver)
    discretisation = discretisation_of(tool, problem)
    if discretisation is not None:
        with attributed(f"the discretisation of {solver}", spare=(AggloError,)):
            discretisation.check(problem, mesh)
    return Posed(problem, mesh, discretisation, solver)
