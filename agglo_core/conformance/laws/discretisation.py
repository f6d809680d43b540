"""Laws for a discretisation: systems fit the mesh, and unknowns represent functions on the mesh."""

from __future__ import annotations

from typing import Any

import numpy as np

from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.drawing import drawn_law
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import require
from agglo_core.conformance.inputs.questions import answer, as_array, in_words
from agglo_core.conformance.inputs.strategies import mesh_cases
from agglo_core.problems import Samples, System

_METHODS = ("check", "coarse_operator", "project", "evaluate", "sample", "errors", "load", "residual_measure")
_EXAMPLES = 30  # drawn meshes for each law


@law("discretisation")
def has_all_methods(subject: Subject) -> None:
    """Every method of the protocol exists, and ``accepts`` contains names of problem kinds."""
    tool = subject.build()
    missing = [name for name in _METHODS if not callable(getattr(tool, name, None))]
    require(not missing, f"it has no method {', '.join(missing)}: see agglo_core.problems.Discretisation")
    kinds = tool.accepts
    require(
        bool(kinds) and all(isinstance(kind, str) for kind in kinds),
        f"accepts is {kinds!r}, expected names of kinds of problem, such as ('diffusion',)",
    )


@drawn_law("discretisation", draw=mesh_cases, examples=_EXAMPLES)
def system_fits_mesh(subject: Subject, case: Case) -> None:
    """``assemble`` returns a System whose blocks are the cells of the mesh."""
    system, cells = answer(subject, subject.build(), case), case.given[1].n_cells
    require(
        isinstance(system, System),
        f"on {case.name}: assemble returned {in_words(system)}, expected a System(A, b, block_offsets)",
    )
    require(
        system.n_blocks == cells,
        f"on {case.name}: the system has {system.n_blocks} blocks, the mesh {cells} cells: block c of "
        "block_offsets holds the unknowns of cell c",
    )


@drawn_law("discretisation", draw=mesh_cases, examples=_EXAMPLES)
def constants_kept(subject: Subject, case: Case) -> None:
    """The projection of a constant is this constant, by ``evaluate`` and by ``sample``."""
    tool, mesh = subject.build(), case.given[1]
    x = as_array(tool.project(mesh, lambda points: np.full(len(points), 3.0)))
    n = answer(subject, tool, case).n
    require(x.shape == (n,), f"on {case.name}: project returned {in_words(x)}, expected ({n},) unknowns")
    samples = tool.sample(mesh, x)
    require(
        isinstance(samples, Samples),
        f"on {case.name}: sample returned {in_words(samples)}, expected Samples",
    )
    evaluated: Any = as_array(tool.evaluate(mesh, x, mesh.cell_centroids))
    for method, values, size in (
        ("evaluate", evaluated, mesh.n_cells),
        ("sample", samples.values, len(samples.cells)),
    ):
        require(
            values.shape == (size,) and bool(np.allclose(values, 3.0, rtol=1e-8)),
            f"on {case.name}: {method} of the projection of 3 is {in_words(values)}, expected 3 at all "
            "points",
        )
