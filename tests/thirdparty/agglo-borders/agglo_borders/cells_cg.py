"""Solver ``cells_cg``."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import cg

from agglo_borders.heat import Heat
from agglo_core.authoring import Hierarchy, OptionError, Solution

__all__ = ["CellsCG"]


class CellsCG:
    """Conjugate gradients for heat problems with one unknown per cell.

    The levels are not used.
    """

    accepts = ("heat",)

    def solve(self, problem: Heat, hierarchy: Hierarchy) -> Solution:
        """Return the temperature of each cell."""
        if not isinstance(problem, Heat):
            raise OptionError(f"cells_cg solves heat problems, given {type(problem).__name__}")
        graph = hierarchy.graph
        links = sparse.csr_array(graph.to_scipy())
        A = sparse.csr_array(sparse.diags_array(links.sum(axis=1) + problem.loss * graph.measures) - links)
        b = problem.source * graph.measures
        norms = [float(np.linalg.norm(b))]
        x, _ = cg(A, b, rtol=1e-10, callback=lambda x: norms.append(float(np.linalg.norm(b - A @ x))))
        done = bool(norms[-1] <= 1e-8 * norms[0])
        reason = "tolerance met" if done else f"residual {norms[-1]:.1e}"
        steps = len(norms) - 1
        return Solution(x, A, b, [(A, None)], np.array(norms), done, reason, steps, {"solve": 0.0})
