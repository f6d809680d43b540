"""Component whose import takes longer than the time limit of its laws."""

from __future__ import annotations

import time

from conformance.mutants.bisectors import Halves

time.sleep(2.5)


class SlowToImport(Halves):
    """Correct."""
