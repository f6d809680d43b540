"""A component whose module takes longer to import than its laws are given."""

from __future__ import annotations

import time

from conformance.mutants.bisectors import Halves

time.sleep(2.5)


class SlowToImport(Halves):
    """Correct."""
