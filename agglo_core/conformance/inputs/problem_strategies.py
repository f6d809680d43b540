"""Strategies of hypothesis for problems that solvers are called with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from agglo_core.conformance.base import Case, Subject
from agglo_core.conformance.inputs.drawn import LAYOUTS, PLANE, SOLID, DrawnMesh
from agglo_core.conformance.inputs.questions import questions
from agglo_core.conformance.inputs.solver_cases import (
    DEFINITE,
    FORMS,
    ORDINARY,
    UNLIKE_DIFFUSION,
    DrawnPlate,
    DrawnProblem,
)
from agglo_core.conformance.inputs.strategies import Draw, composite, meshes, one_of_values, rarely
from agglo_core.problems import Diffusion, Linear


def solver_cases(
    subject: Subject,
    sorts: Sequence[str] = ORDINARY,
    options: Sequence[Mapping[str, Any]] = ({},),
    tags: tuple[tuple[str, str], ...] = (),
) -> Any:
    """Draw problems of the given sorts, except for kinds of problem that a solver refuses.

    For a solver of other kinds of problem, draw from their examples. Return None if nothing is left.
    """
    standard = questions(subject)
    accepted = {case.sort for case in standard}
    widths = (1, 1) * ("linear" in accepted) + (2, 3) * ("linear, in blocks" in accepted)
    drawn = [
        sort
        for sort in sorts
        if ("Diffusion" in accepted if sort in ("diffusion", "undefined source") else widths)
    ]
    others = [case for case in standard if not isinstance(case.given[0], Diffusion | Linear)]
    choices: list[str | Case] = [*drawn, *([] if tags else others)]
    return _solver_cases(subject, choices, widths or (1,), options, tags) if choices else None


@composite
def _solver_cases(
    draw: Draw,
    subject: Subject,
    choices: Sequence[str | Case],
    widths: Sequence[int],
    options: Sequence[Mapping[str, Any]],
    tags: tuple[tuple[str, str], ...],
) -> Case:
    choice = draw(one_of_values(choices))
    if isinstance(choice, Case):
        return replace(choice, options=draw(one_of_values(options)))
    families = (*PLANE, *SOLID[:2]) if subject.promised("3d") else PLANE
    drawn = meshes(
        families, (9, 1, 2, 4, 16, 30), connected=bool(tags), shifts=(0.0, 3.0), stretches=(1.0, 0.2, 5.0)
    )
    recipe = DrawnProblem(
        replace(draw(drawn), tags=tags),
        choice,
        layout=draw(one_of_values(LAYOUTS[:4])),
        parts=draw(one_of_values((4, 1, 2, 9))),
        levels=draw(one_of_values((1, 2, 3))),
        width=draw(one_of_values(widths)),
        form=draw(one_of_values(FORMS)),
        meshless=draw(rarely((False, True))),
    )
    return replace(recipe.case, options=draw(one_of_values(options)))


def linear_cases(subject: Subject) -> Any:
    """Draw linear systems, also unlike diffusion, which a solver may refuse."""
    return solver_cases(subject, (*ORDINARY[1:], *DEFINITE, *UNLIKE_DIFFUSION))


@composite
def plates(draw: Draw, subject: Subject) -> Case:
    """Draw a diffusion problem with a known solution, also in 3-D if the solver promises 3-D."""
    solid = subject.promised("3d") and draw(one_of_values((False, True)))
    recipe = DrawnMesh(
        "boxes" if solid else "rectangles",
        cells=draw(one_of_values((16, 1, 4, 30))),
        seed=draw(one_of_values(range(4))),
        grading=draw(rarely((1.0, 5.0))),
        stretch=draw(one_of_values((1.0, 0.5, 3.0))),
        shift=draw(rarely((0.0, 3.0, 1e6))),
        scale=draw(rarely((1.0, 1e-3, 1e3))),
        renumbered=draw(one_of_values((False, True))),
    )
    return DrawnPlate(
        recipe,
        left=draw(one_of_values((1.0, 4.0))),
        right=draw(one_of_values((1.0, 50.0, 0.1))),
        form=draw(one_of_values(FORMS)),
        fluxes=draw(one_of_values((0, 1, 2, 3))),
        merged=draw(one_of_values((False, True))),
        tag=draw(one_of_values(("boundary", "edge"))),
    ).case
