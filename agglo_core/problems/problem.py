"""What every problem has, and the form of its data."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Protocol, runtime_checkable

from agglo_core.arrays import Float

Field = float | Float | Callable[[Float], Float]
"""A number, one value per cell ``(n,)``, or a callable of points ``(q, d)`` returning ``(q,)``."""


@runtime_checkable
class Problem(Protocol):
    """Anything a solver may be asked to solve: a record that names its kind.

    ``kind`` is the name under which the class is declared as a component of the kind ``problem``; a solver
    lists those it takes in ``accepts``. Optional is ``posed_on(mesh)``, which returns the problem as it is
    on a mesh: called by :func:`~agglo_core.problems.named_problem`.

    Examples
    --------
    >>> from agglo_core.problems import Problem
    >>> problem: Problem = agglo.Diffusion(source=2.0)
    >>> problem.kind
    'diffusion'
    """

    kind: ClassVar[str]
