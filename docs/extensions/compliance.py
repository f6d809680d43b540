"""Table of agglo's own components tested against the laws of their kind.

The table is ``docs/reference/compliance.md``, and printed by ``python docs/extensions/compliance.py``.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any

from agglo_core.conformance import Result, check
from agglo_core.registry import KINDS, Component, default

_REGULAR = ("triangles", "squares", "hexagons", "strip", "disconnected", "boxes", "tetrahedra")
_RANDOM = ("random_triangles", "voronoi", "ring", "random_tetrahedra", "voronoi3d", "prisms")
_OPTIONS: Mapping[str, Mapping[str, Any]] = {
    "diameter_ratio": {"h_star": 0.5},
    "paper": {"name": "squares"},
    **{name: {"n": 3} for name in _REGULAR},
    **{name: {"n": 20} for name in _RANDOM},
}
"""Values for required options of built-in components."""

_COMPLIANCE_HEAD = """# Compliance of agglo's own components

Every component of the distribution, tested against the laws of its kind and those of its promises. This page
is written by `python docs/extensions/compliance.py`.
"""


def compliance_page(results: Mapping[tuple[str, str], Sequence[Result]]) -> str:
    """Return a Markdown page with the laws kept and broken by each component in :func:`own_results`."""
    rows = ["| kind | component | laws | promises kept | laws that fail |", "|---|---|---|---|---|"]
    for (kind, name), law_results in results.items():
        passes = [result for result in law_results if result.passed]
        promises = _promises(kind, name)
        failures = ", ".join(f"`{result.law}`" for result in law_results if not result.passed)
        rows.append(
            f"| {kind} | `{name}` | {len(passes)} of {len(law_results)} | {promises} | {failures or 'none'} |"
        )
    return f"{_COMPLIANCE_HEAD}\n" + "\n".join(rows) + "\n"


def own_components() -> list[Component]:
    """List all components of the agglo distribution by kind, even if a package they need is missing."""
    components = [record.component for record in default().list() if record.in_tree and record.component]
    return sorted(components, key=lambda component: list(KINDS).index(component.kind))


def own_results() -> dict[tuple[str, str], list[Result]]:
    """Test every component of the agglo distribution, and return the results by kind and name.

    Raises
    ------
    PluginError
        If a component cannot be used here because a package is missing.
    """
    return {
        (component.kind, component.name): own_result(component.kind, component.name)
        for component in own_components()
    }


def own_result(kind: str, name: str) -> list[Result]:
    """Test one component of the agglo distribution against its laws.

    Raises
    ------
    PluginError
        If the component cannot be used here.
    """
    return check(name, kind, options=_OPTIONS.get(name))


def _promises(kind: str, name: str) -> str:
    component = next(c for c in own_components() if (c.kind, c.name) == (kind, name))
    promises = component.promises.items()
    return ", ".join(f"`{key}`" if value is True else f"`{key}` {value}" for key, value in promises if value)


if __name__ == "__main__":
    sys.stdout.write(compliance_page(own_results()))
