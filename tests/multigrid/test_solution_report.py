"""What a solution tells of its solver, as data and as text."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

from agglo_core import samples
from agglo_core.problems import Linear, Solution
from agglo_core.solvers.solution_report import report, text

MESH = samples.squares(2)
A, b = sparse.eye_array(4).tocsr(), np.ones(4)
PLAIN = Solution(
    b, A, b, [(A, None)], np.array([2.0, 1.0, 0.1, 0.001]), True, "tolerance met", 3, {"solve": 0.5}
)
TOLD = replace(
    PLAIN,
    operator_complexity=1.5,
    grid_complexity=1.25,
    memory=12_300_000,
    cpu_seconds={"solve": 0.4},
    choice="vertex patches, since cells are no triangles and the degree is above 1 on this mesh",
    advice="many right-hand sides: a direct solver is faster for each further one, and fits into memory",
)


def test_contraction_is_a_geometric_mean() -> None:
    assert PLAIN.contraction == pytest.approx((0.001 / 2.0) ** (1 / 3))
    assert PLAIN.asymptotic_contraction == pytest.approx(0.001**0.5)
    for residuals in ([1.0], [0.0, 0.0], [1.0, 0.0], [1.0, np.inf], []):
        assert replace(PLAIN, residuals=np.array(residuals)).contraction is None


def test_attributes_that_a_solver_lacks_are_computed_or_empty() -> None:
    data = report(MESH, Linear(A, b, np.arange(5)), PLAIN)
    assert (data["operator_complexity"], data["grid_complexity"]) == (1.0, 1.0)
    assert (data["memory"], data["cpu_seconds"], data["choice"], data["advice"]) == (None, {}, "", "")
    assert "advice" not in text("x", data)


def test_attributes_of_a_solution_are_in_data_and_text() -> None:
    data = report(MESH, Linear(A, b, np.arange(5)), TOLD)
    assert json.loads(json.dumps(data)) == data
    assert (data["operator_complexity"], data["grid_complexity"], data["memory"]) == (1.5, 1.25, 12_300_000)
    lines = text("x", data)
    assert max(map(len, lines.splitlines())) <= 80
    said = " ".join(lines.split())
    assert f"solver: {TOLD.choice} " in said
    assert said.endswith(f"advice: {TOLD.advice}")
    assert "operator complexity 1.50, grid complexity 1.25, contraction 0.0794, memory 12.3 MB" in said
    assert "clock: solve 0.50 s processor: solve 0.40 s" in said
