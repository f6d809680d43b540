"""Bisectors that never answer, or take the process with them."""

from __future__ import annotations

import os
import time

from conformance.mutants.bisectors import Halves


class Hangs(Halves):
    def bisect(self, graph, rng):
        while True:
            time.sleep(0.01)


class HangsWhenBuilt(Halves):
    def __init__(self):
        time.sleep(1000)


class Dies(Halves):
    def bisect(self, graph, rng):
        os._exit(7)
