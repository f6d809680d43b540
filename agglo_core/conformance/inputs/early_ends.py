"""Degenerate and invalid test cases, which a component may refuse or fail on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agglo_core.arrays import frozen_float, frozen_int
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.cases import cases, cases_in_3d, laplacian, tiny
from agglo_core.conformance.inputs.solver_cases import DEFINITE, UNLIKE_DIFFUSION, DrawnProblem
from agglo_core.hierarchy import Hierarchy
from agglo_core.problems import Diffusion, Linear


def early_ends(kind: str) -> list[Case]:
    """Return degenerate and invalid test cases, which a component may refuse or fail on."""
    early_cases = [*tiny(kind), *cases_in_3d(kind)]
    if kind == "solver":
        unusual = [DrawnProblem(sort=sort).case for sort in (*DEFINITE, *UNLIKE_DIFFUSION)]
        return [*early_cases, *_problems(), *unusual]
    if kind == "metric":
        mesh = small_meshes.grid(4, 3)
        wrong = {"labels with a gap": np.arange(12) % 3 * 2, "labels for too few cells": np.arange(5) % 2}
        early_cases += [Case(name, (mesh, frozen_int(labels))) for name, labels in wrong.items()]
    if kind == "smoother":
        case = cases(kind)[0]
        level, b, x = case.given
        nothing = replace(level, A=0.0 * level.A, inherited=0.0 * level.A)
        early_cases += [
            replace(case, name="zeros", given=(level, 0.0 * b, 0.0 * x)),
            replace(case, name="a right-hand side with NaN", given=(level, np.nan * b, x)),
            replace(case, name="a matrix of zeros", given=(nothing, b, x)),
        ]
    return early_cases


def _problems() -> list[Case]:
    """Return test cases for solvers with zero data, with invalid data, and with sizes that do not match."""
    hierarchy = cases("solver")[0].given[1]
    graph = hierarchy.graph
    fine = laplacian(graph, 1)
    n, none = graph.n, np.zeros(graph.n)
    meshless_hierarchy = Hierarchy(
        None, graph, list(hierarchy.levels[:1]), list(hierarchy.targets[:1]), nested=True
    )
    problems = {
        "no source": Diffusion(source=0.0),
        "a source of NaN": Diffusion(source=np.nan),
        "a negative coefficient": Diffusion(kappa=-1.0),
        "a right-hand side of zeros": replace(fine, b=frozen_float(none)),
        "a right-hand side with NaN": replace(fine, b=frozen_float(none + np.nan)),
        "a singular system": laplacian(graph, 1, shift=0.0),
        "a matrix of zeros": replace(fine, A=0.0 * fine.A),
        "a system with too few cells": Linear(fine.A[1:, 1:], fine.b[1:], np.arange(n)),
    }
    problem_cases = [Case(name, (problem, hierarchy)) for name, problem in problems.items()]
    return [*problem_cases, Case("diffusion without a mesh", (Diffusion(), meshless_hierarchy))]
