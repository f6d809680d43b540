"""Write a reference page to stdout: ``python -m agglo_core.conformance laws|compliance|formats``."""

from __future__ import annotations

import sys

from agglo_core.conformance.engine.format_page import format_table
from agglo_core.conformance.engine.reference_pages import compliance_page, laws_page, own_results


def page(name: str) -> str:
    """Return the reference page ``laws``, ``compliance`` or ``formats`` as Markdown."""
    if name == "laws":
        return laws_page()
    return compliance_page(own_results()) if name == "compliance" else f"{format_table()}\n"


if __name__ == "__main__":
    if sys.argv[1:] not in (["laws"], ["compliance"], ["formats"]):
        sys.exit("usage: python -m agglo_core.conformance laws|compliance|formats")
    sys.stdout.write(page(sys.argv[1]))
