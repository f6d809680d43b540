"""``python -m agglo_core.conformance laws|compliance``: write a page of the reference to stdout."""

from __future__ import annotations

import sys

from agglo_core.conformance.reference_pages import compliance_page, laws_page, own_results


def main(page: str) -> None:
    """Write one of the pages."""
    sys.stdout.write(laws_page() if page == "laws" else compliance_page(own_results()))


if __name__ == "__main__":
    if sys.argv[1:] not in (["laws"], ["compliance"]):
        sys.exit("usage: python -m agglo_core.conformance laws|compliance")
    main(sys.argv[1])
