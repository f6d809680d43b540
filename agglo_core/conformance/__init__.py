"""Conformance tests: check a component, such as a bisector or solver, against the laws of its kind.

A law is a property that every component of a kind must have. Each failure is reported with its remedy.

Three interfaces to the same laws::

    agglo check mine                                     # a table; exit code 3 if a law fails

    from agglo_core.conformance import check
    failures = [r for r in check("bisector:mine") if not r.passed]

    from agglo_core.conformance import conformance
    test_conformance = conformance("bisector:mine")      # in a pytest file

Messages show drawn inputs as code, with :class:`DrawnMesh`, :class:`DrawnGraph`, :class:`DrawnLevel`,
:class:`DrawnProblem`, :class:`DrawnPlate` and :func:`drawn_labels`.
"""

from agglo_core.conformance.engine.front import conformance
from agglo_core.conformance.engine.judging import Result
from agglo_core.conformance.engine.runner import check
from agglo_core.conformance.inputs.drawn import DrawnGraph, DrawnMesh, drawn_labels
from agglo_core.conformance.inputs.multigrid_cases import DrawnLevel
from agglo_core.conformance.inputs.solver_cases import DrawnPlate, DrawnProblem

__all__ = [
    "DrawnGraph",
    "DrawnLevel",
    "DrawnMesh",
    "DrawnPlate",
    "DrawnProblem",
    "Result",
    "check",
    "conformance",
    "drawn_labels",
]
