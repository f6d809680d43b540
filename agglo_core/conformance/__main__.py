"""Write a reference page to stdout: ``python -m agglo_core.conformance laws|compliance``."""

from __future__ import annotations

import sys

from agglo_core.conformance.engine.reference_pages import compliance_page, laws_page, own_results

if __name__ == "__main__":
    if sys.argv[1:] not in (["laws"], ["compliance"]):
        sys.exit("usage: python -m agglo_core.conformance laws|compliance")
    sys.stdout.write(laws_page() if sys.argv[1] == "laws" else compliance_page(own_results()))
