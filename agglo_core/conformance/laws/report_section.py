"""Laws for a section of the report."""

from __future__ import annotations

import re

from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import require
from agglo_core.conformance.inputs.mesh_cases import UNSAFE
from agglo_core.conformance.inputs.questions import answer, in_words, questions


@law("section")
def titled(subject: Subject) -> None:
    """The title is a nonempty string."""
    title = getattr(subject.build(), "title", None)
    require(
        isinstance(title, str) and title.strip(),
        f"attribute title is {title!r}, expected a string, the heading of the section",
    )


@law("section")
def html_text(subject: Subject) -> None:
    """The method ``html`` returns a string."""
    for case in questions(subject):
        html = answer(subject, subject.build(), case)
        require(isinstance(html, str), f"{case.name}: html returned {in_words(html)}, expected a string")


@law("section")
def no_scripts(subject: Subject) -> None:
    """The HTML contains no scripts, external resources or event handlers."""
    for case in questions(subject):
        match = re.search(
            r"<\s*(script|iframe|object|embed|link)|<[^>]*\s(on\w+\s*=|src\s*=\s*[\"']?https?:)",
            answer(subject, subject.build(), case),
            re.I,
        )
        require(
            match is None,
            f"{case.name}: html contains {match and match[0][:40]!r}: a report is one static file; draw "
            "with SVG and style attributes",
        )


@law("section")
def names_escaped(subject: Subject) -> None:
    """Names and messages are escaped for HTML."""
    for case in questions(subject):
        text = answer(subject, subject.build(), case)
        require(
            UNSAFE not in text and "<b id=" not in text,
            f"{case.name}: html contains a name unescaped, tags included: use html.escape(name)",
        )
