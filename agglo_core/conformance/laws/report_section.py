"""Laws for a section of the report."""

from __future__ import annotations

import re

from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import require
from agglo_core.conformance.inputs.mesh_cases import UNSAFE
from agglo_core.conformance.inputs.questions import answer, in_words, questions

_ACTIVE = re.compile(
    r"<\s*(script|iframe|object|embed|link)|<[^>]*\s(on\w+\s*=|src\s*=\s*[\"']?https?:)", re.IGNORECASE
)


@law("section")
def titled(subject: Subject) -> None:
    """The title is a nonempty string."""
    title = getattr(subject.build(), "title", None)
    require(
        isinstance(title, str) and title.strip(),
        f"attribute title is {title!r}, expected a string, the heading of the section",
    )


@law("section")
def static_html(subject: Subject) -> None:
    """``html`` returns text without scripts, event handlers or external resources, and escapes names."""
    for case in questions(subject):
        html = answer(subject, subject.build(), case)
        require(isinstance(html, str), f"{case.name}: html returned {in_words(html)}, expected a string")
        active = _ACTIVE.search(html)
        require(
            active is None,
            f"{case.name}: html contains {active and active[0][:40]!r}: a report is one static file; draw "
            "with SVG and style attributes",
        )
        require(
            UNSAFE not in html and "<b id=" not in html,
            f"{case.name}: html contains a name unescaped, tags included: use html.escape(name)",
        )
