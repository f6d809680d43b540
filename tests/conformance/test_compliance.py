"""Our own components keep every law and what they promise; the pages the suite writes are up to date."""

from __future__ import annotations

from pathlib import Path

import pytest
from compliance import compliance_page, own_components, own_result

from agglo_core.conformance.__main__ import laws_page
from agglo_core.registry import default

PAGES = Path(__file__).parents[2] / "docs/reference"
OWN = [(component.kind, component.name) for component in own_components()]
REMEDY = f"python docs/extensions/compliance.py > {PAGES / 'compliance.md'}"


def lines_of_the_page() -> list[str]:
    return (PAGES / "compliance.md").read_text(encoding="utf-8").splitlines()


@pytest.mark.slow
@pytest.mark.usefixtures("warm_process")
@pytest.mark.parametrize("own", OWN, ids=":".join)
def test_our_components_keep_the_laws_as_the_page_says(own: tuple[str, str]) -> None:
    record = default().record(*own)
    if record.state != "ok":
        pytest.skip(f"{own[1]}: {record.reason}")
    results = own_result(*own)
    assert [(result.law, result.message) for result in results if not result.passed] == []
    assert compliance_page({own: results}).splitlines()[-1] in lines_of_the_page(), REMEDY


def test_the_page_of_compliance_has_a_row_for_each() -> None:
    head, page = compliance_page({}).splitlines(), lines_of_the_page()
    assert page[: len(head)] == head, REMEDY
    rows = [tuple(cell.strip(" `") for cell in row.split("|")[1:3]) for row in page[len(head) :]]
    assert rows == OWN, REMEDY


def test_there_is_a_component_of_each_sort() -> None:
    assert {kind for kind, _ in OWN} >= {"bisector", "refiner", "fixer", "metric"}


def test_the_page_of_laws_is_up_to_date() -> None:
    page = PAGES / "laws.md"
    assert page.read_text(encoding="utf-8") == laws_page(), f"python -m agglo_core.conformance laws > {page}"
