"""The solver direct of the core, without the plugin that discretises."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

from agglo_core import Component, Hierarchy, Mesh, Registry, hookimpl, samples
from agglo_core.errors import OptionError
from agglo_core.problems import Diffusion, Linear, System
from agglo_core.solvers.direct import Direct
from agglo_core.solvers.fine_system import discretised_system


def test_linear_systems_need_no_discretisation() -> None:
    mesh = samples.squares(4)
    hierarchy = Hierarchy(mesh, mesh.graph, [], [], nested=True)
    alone = Direct(registry=Registry())
    problem = Linear.example(mesh)
    solution = alone.solve(problem, hierarchy)
    assert solution.converged
    assert np.allclose(problem.A @ solution.x, problem.b)
    with pytest.raises(OptionError, match="must be discretised"):
        alone.solve(Diffusion(), hierarchy)


class Upwind:
    """Discretisation with a nonsymmetric matrix, and two unknowns declared as inner."""

    accepts = ("diffusion",)

    def __init__(self) -> None:
        self.A = sparse.csr_array(sparse.diags_array([[4.0] * 4, [-1.0] * 3, [-2.0] * 3], offsets=[0, 1, -1]))

    def assemble(self, problem: Diffusion, mesh: Mesh) -> System:
        return System.trusted(self.A, np.arange(1.0, 5.0), np.arange(5), mesh)

    def inner_unknowns(self, mesh: Mesh) -> np.ndarray:
        return np.array([[1], [3]])


def test_nonsymmetric_systems_keep_their_inner_unknowns() -> None:
    how = Upwind()
    problem = Diffusion(convection=(1.0, 0.0))
    system = discretised_system(problem, samples.squares(2), how)
    assert system.condensed is None
    factor = system.matrix_factor
    np.testing.assert_array_equal(system.A.toarray(), factor * how.A.toarray())
    assert discretised_system(Diffusion(), samples.squares(2), how).condensed is not None


def test_discretisations_need_no_degree() -> None:
    class Plugin:
        @hookimpl
        def agglo_components(self) -> list[Component]:
            return [Component("discretisation", "cells", "cell_values:CellValues")]

    registry = Registry()
    registry.register(Plugin(), "own")
    mesh = samples.squares(4)
    hierarchy = Hierarchy(mesh, mesh.graph, [], [], nested=True)
    solution = Direct(discretisation="cells", registry=registry).solve(Diffusion(), hierarchy)
    assert solution.converged
    assert solution.x.shape == (16,)
    with pytest.raises(OptionError, match="no option 'degree'"):
        Direct(2, discretisation="cells", registry=registry)
