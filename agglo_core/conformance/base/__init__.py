"""Base classes of the conformance tests: test case, law, failure, and component under test."""

from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.law import ASKED, Law, examples_of, law
from agglo_core.conformance.base.subject import Subject, subject_of
from agglo_core.conformance.base.verdict import (
    ATTRIBUTES,
    FORM,
    Broken,
    as_array,
    in_words,
    require,
    require_array,
    require_close,
)

__all__ = [
    "ASKED",
    "ATTRIBUTES",
    "FORM",
    "Broken",
    "Case",
    "Law",
    "Subject",
    "as_array",
    "examples_of",
    "in_words",
    "law",
    "require",
    "require_array",
    "require_close",
    "subject_of",
]
