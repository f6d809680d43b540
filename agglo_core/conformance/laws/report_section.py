"""Laws for a section of the report."""

from __future__ import annotations

from html.parser import HTMLParser

from agglo_core.conformance.base import Case, Subject, in_words, law, require
from agglo_core.conformance.inputs.questions import answer
from agglo_core.conformance.inputs.strategies import section_cases


class _ActiveTags(HTMLParser):
    """Parser that collects tags with scripts, event handlers or external resources."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.found: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Keep the text of an active tag."""
        external = any(name == "src" and (value or "").startswith(("http", "//")) for name, value in attrs)
        handler = any(name.startswith("on") for name, _ in attrs)
        if external or handler or tag in ("script", "iframe", "object", "embed", "link"):
            self.found.append(self.get_starttag_text() or tag)


@law("section")
def titled(subject: Subject) -> None:
    """The title is a nonempty string."""
    title = getattr(subject.build(), "title", None)
    require(
        isinstance(title, str) and title.strip(),
        f"attribute title is {title!r}, expected a string, the heading of the section",
    )


@law("section", draw=section_cases, examples=20)
def static_html(subject: Subject, case: Case) -> None:
    """``html`` returns text without scripts, event handlers or external resources, and escapes names."""
    html = answer(subject, case)
    require(isinstance(html, str), f"html returned {in_words(html)}, expected a string")
    mesh, runs = case.given
    texts = [mesh.name, *mesh.cell_tags, *(text for run in runs for text in (run.name, run.error))]
    raw = [text for text in texts if "<" in text and text in html]
    require(not raw, f"html contains {raw} unescaped, tags included: use html.escape(name)")
    active = _ActiveTags(html).found
    require(
        not active,
        f"html contains {active[:1]!r:.60}: a report is one static file; draw with "
        "SVG and style attributes, and escape names in attributes",
    )
