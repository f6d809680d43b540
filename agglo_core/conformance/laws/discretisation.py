"""Laws for a discretisation: systems fit the mesh, and unknowns represent functions on the mesh."""

from __future__ import annotations

from typing import Any

import numpy as np

from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import require
from agglo_core.conformance.inputs.questions import answer, as_array, in_words, questions
from agglo_core.problems import Samples, System

_METHODS = ("check", "coarse_operator", "project", "evaluate", "sample", "errors", "load", "residual_measure")


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


@law("discretisation")
def system_fits_mesh(subject: Subject) -> None:
    """``assemble`` returns a System whose blocks are the cells of the mesh."""
    for case in questions(subject):
        system = answer(subject, subject.build(), case)
        require(
            isinstance(system, System),
            f"on {case.name}: assemble returned {in_words(system)}, expected a System(A, b, block_offsets)",
        )
        cells = case.given[1].n_cells
        require(
            system.n_blocks == cells,
            f"on {case.name}: the system has {system.n_blocks} blocks, the mesh {cells} cells: block c of "
            "block_offsets holds the unknowns of cell c",
        )


@law("discretisation")
def constants_kept(subject: Subject) -> None:
    """The projection of a constant is this constant, by ``evaluate`` and by ``sample``."""
    for case in questions(subject):
        tool, mesh = subject.build(), case.given[1]
        x = as_array(tool.project(mesh, lambda points: np.full(len(points), 3.0)))
        n = answer(subject, tool, case).n
        require(x.shape == (n,), f"on {case.name}: project returned {in_words(x)}, expected ({n},) unknowns")
        values = as_array(tool.evaluate(mesh, x, mesh.cell_centroids))
        _require_constant(case.name, "evaluate", values, (mesh.n_cells,), "the centroid of each cell")
        samples = tool.sample(mesh, x)
        require(
            isinstance(samples, Samples),
            f"on {case.name}: sample returned {in_words(samples)}, expected Samples",
        )
        _require_constant(case.name, "sample", samples.values, (len(samples.cells),), "all its points")


def _require_constant(name: str, method: str, values: Any, shape: tuple[int, ...], place: str) -> None:
    require(
        values.shape == shape and bool(np.allclose(values, 3.0, rtol=1e-8)),
        f"on {name}: {method} of the projection of 3 is {in_words(values)}, expected 3 at {place}",
    )
