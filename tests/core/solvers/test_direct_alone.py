"""The solver direct of the core, without the plugin that discretises."""

from __future__ import annotations

import numpy as np
import pytest

from agglo_core import Component, Hierarchy, Registry, hookimpl, samples
from agglo_core.errors import OptionError
from agglo_core.problems import Diffusion, Linear
from agglo_core.solvers.direct import Direct


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
