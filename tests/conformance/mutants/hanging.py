"""Bisectors that never answer or kill the process."""

from __future__ import annotations

import os
import time

from conformance.mutants.bisectors import Halves
from numba.core.compiler_lock import global_compiler_lock


class Hangs(Halves):
    def bisect(self, graph, rng):
        while True:
            time.sleep(0.01)


class Dies(Halves):
    def bisect(self, graph, rng):
        os._exit(7)


class CompilesForLong(Halves):
    """Take long in the first call, like a component that compiles kernels."""

    compiled = False

    def bisect(self, graph, rng):
        if not CompilesForLong.compiled:
            CompilesForLong.compiled = True
            with global_compiler_lock:
                time.sleep(2.5)
        return super().bisect(graph, rng)
