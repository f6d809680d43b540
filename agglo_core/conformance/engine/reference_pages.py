"""Pages of the reference made by the suite itself: the laws, and the results of agglo's own components."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from agglo_core.conformance.base.law import Law
from agglo_core.conformance.engine.judging import Result
from agglo_core.conformance.engine.runner import check
from agglo_core.conformance.laws import all_laws, laws_of
from agglo_core.registry import KINDS, Component, default

_REGULAR = ("triangles", "squares", "hexagons", "strip", "disconnected", "boxes", "tetrahedra")
_RANDOM = ("random_triangles", "voronoi", "ring", "random_tetrahedra", "voronoi3d", "prisms")
_OPTIONS: Mapping[str, Mapping[str, Any]] = {
    "diameter_ratio": {"h_star": 0.5},
    "paper": {"name": "squares"},
    **{name: {"n": 3} for name in _REGULAR},
    **{name: {"n": 20} for name in _RANDOM},
}
"""Values for options that must be given."""

_LAWS_HEAD = """# The laws

What `agglo check` asks of a component, in the order in which it asks. A law with a promise is asked only of
components that make it; nothing switches a law off but a strict `xfail` in the author's own tests. This page
is written by `python -m agglo_core.conformance laws`.
"""

_COMPLIANCE_HEAD = """# How agglo's own components stand to the laws

Every component of the distribution, judged by the laws of its kind and by those its promises bring. This page
is written by `python -m agglo_core.conformance compliance`.
"""


def laws_page() -> str:
    """The page of laws: name, promise and sentence, kind by kind (Markdown)."""
    text = [_LAWS_HEAD, f"{len(all_laws())} laws in all; those of several kinds are listed under each.\n"]
    for kind in KINDS:
        own = laws_of(kind)
        text.append(f"## {kind.capitalize()}: {len(own)} laws\n\n{_table(own)}")
    return "\n".join(text)


def compliance_page(results: Mapping[tuple[str, str], Sequence[Result]]) -> str:
    """The page of results by (kind, name), as :func:`own_results` gives them (Markdown)."""
    rows = ["| kind | component | laws | promises kept | laws that fail |", "|---|---|---|---|---|"]
    for (kind, name), judged in results.items():
        kept = [result for result in judged if result.passed]
        promises = _promises(kind, name)
        failed = ", ".join(f"`{result.law}`" for result in judged if not result.passed)
        rows.append(f"| {kind} | `{name}` | {len(kept)} of {len(judged)} | {promises} | {failed or 'none'} |")
    return f"{_COMPLIANCE_HEAD}\n" + "\n".join(rows) + "\n"


def own_components() -> list[Component]:
    """Components of the agglo distribution itself, whatever their state, by kind."""
    own = [record.component for record in default().list() if record.in_tree and record.component]
    return sorted(own, key=lambda component: list(KINDS).index(component.kind))


def own_results() -> dict[tuple[str, str], list[Result]]:
    """Results of every component of agglo itself by (kind, name).

    Raises
    ------
    PluginError
        If one cannot be used here, for want of a package.
    """
    return {(own.kind, own.name): own_result(own.kind, own.name) for own in own_components()}


def own_result(kind: str, name: str) -> list[Result]:
    """Results of one component of agglo itself; PluginError if it cannot be used here."""
    return check(name, kind, options=_OPTIONS.get(name))


def _table(laws: Sequence[Law]) -> str:
    rows = [
        f"| `{law.name}` | {f'`{law.promise}`' if law.promise else ''} | {law.sentence} |" for law in laws
    ]
    return "\n".join(["| law | promise | what it says |", "|---|---|---|", *rows]) + "\n"


def _promises(kind: str, name: str) -> str:
    component = next(own for own in own_components() if (own.kind, own.name) == (kind, name))
    made = component.promises.items()
    return ", ".join(f"`{key}`" if value is True else f"`{key}` {value}" for key, value in made if value)
