"""A run and a solve with NUMBA_DISABLE_JIT, in which a debugger follows kernels line by line.

The meshes are not symmetric, since rounding decides ties, and machine code adds in another order.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest

SCRIPT = """
import json
import agglo_core as agglo

answers = []
for mesh in (agglo.samples.voronoi(60, seed=1), agglo.samples.random_tetrahedra(12, seed=1)):
    hierarchy = agglo.agglomerate(mesh, n_parts=(12, 4))
    solution = agglo.solve(hierarchy, degree=1)
    levels = [labels.tolist() for labels in hierarchy.levels]
    answers.append([levels, solution.iterations, solution.x.tolist()])
print(json.dumps(answers))
"""


def answers(printed: str) -> list[tuple[list[list[int]], int, list[float]]]:
    """Labels, iterations and unknowns that the script has printed."""
    return [tuple(answer) for answer in json.loads(printed)]


@pytest.mark.slow
def test_kernels_in_python_give_the_same_labels_and_solutions(capsys: pytest.CaptureFixture[str]) -> None:
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", SCRIPT],  # hashes overflow, as they do in machine code
        capture_output=True, text=True, check=True, env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
    )  # fmt: skip
    exec(SCRIPT, {})
    for plain, compiled in zip(answers(run.stdout), answers(capsys.readouterr().out), strict=True):
        assert plain[:2] == compiled[:2]
        assert plain[2] == pytest.approx(compiled[2], abs=1e-9 * np.abs(compiled[2]).max())
