"""The solver direct of the core, without the plugin that discretises."""

from __future__ import annotations

import numpy as np
import pytest

from agglo_core import Hierarchy, Registry, samples
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
