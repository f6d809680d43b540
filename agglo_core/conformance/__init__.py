"""Conformance suite: judge a component by the laws of its kind and report each failure with its remedy.

Three interfaces to the same laws::

    agglo check mine                                     # a table; exit code 3 if a law fails

    from agglo_core.conformance import check
    failures = [r for r in check("bisector:mine") if not r.passed]

    from agglo_core.conformance import conformance
    test_conformance = conformance("bisector:mine")      # in a pytest file
"""

from agglo_core.conformance.engine.front import conformance
from agglo_core.conformance.engine.judging import Result
from agglo_core.conformance.engine.runner import check

__all__ = ["Result", "check", "conformance"]
