"""Our own components keep every law and what they promise; the pages the suite writes are up to date."""

from __future__ import annotations

from pathlib import Path

import pytest

from agglo_core.conformance.judging import Result
from agglo_core.conformance.reference_pages import compliance_page, laws_page, own_components, own_results
from agglo_core.registry import default

PAGES = Path(__file__).parents[2] / "docs/reference"
OWN = [(component.kind, component.name) for component in own_components()]

Results = dict[tuple[str, str], list[Result]]


@pytest.fixture(scope="module")
def results() -> Results:
    """Every component of ours, judged once."""
    for kind, name in OWN:
        record = default().record(kind, name)
        if record.state != "ok":
            pytest.skip(f"{name}: {record.reason}")
    return own_results()


@pytest.mark.slow
@pytest.mark.parametrize("own", OWN, ids=":".join)
def test_our_components_keep_the_laws(results: Results, own: tuple[str, str]) -> None:
    assert [(result.law, result.message) for result in results[own] if not result.passed] == []


def test_there_is_a_component_of_each_sort() -> None:
    assert {kind for kind, _ in OWN} >= {"bisector", "refiner", "fixer", "metric"}


def test_the_page_of_laws_is_up_to_date() -> None:
    page = PAGES / "laws.md"
    assert page.read_text(encoding="utf-8") == laws_page(), f"python -m agglo_core.conformance laws > {page}"


@pytest.mark.slow
def test_the_page_of_compliance_is_up_to_date(results: Results) -> None:
    page = PAGES / "compliance.md"
    assert page.read_text(encoding="utf-8") == compliance_page(results), (
        f"python -m agglo_core.conformance compliance > {page}"
    )
