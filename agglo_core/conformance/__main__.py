"""Write the reference page of the laws to stdout: ``python -m agglo_core.conformance laws``."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from agglo_core.conformance.base import Law
from agglo_core.conformance.laws import all_laws, laws_of
from agglo_core.registry import KINDS

_HEAD = """# The laws

`agglo check` tests a component against the laws of its kind, in the order listed here. A law with a promise
applies only to components that make this promise. A law cannot be switched off, except by a strict `xfail` in
the author's own tests. This page is written by `python -m agglo_core.conformance laws`.
"""


def laws_page() -> str:
    """Return a Markdown page with the laws of each component kind: name, promise and statement."""
    total = f"{len(all_laws())} laws in total; laws for several kinds are listed under each of them.\n"
    text = [_HEAD, total]
    for kind in KINDS:
        laws = laws_of(kind)
        text.append(f"## {kind.capitalize()}: {len(laws)} laws\n\n{_table(laws)}")
    return "\n".join(text)


def _table(laws: Sequence[Law]) -> str:
    rows = [
        f"| `{law.name}` | {f'`{law.promise}`' if law.promise else ''} | {law.sentence} |" for law in laws
    ]
    return "\n".join(["| law | promise | requirement |", "|---|---|---|", *rows]) + "\n"


if __name__ == "__main__":
    if sys.argv[1:] != ["laws"]:
        sys.exit("usage: python -m agglo_core.conformance laws")
    sys.stdout.write(laws_page())
