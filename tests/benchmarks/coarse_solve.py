"""CPU time of the dense coarse solve, over that of a BLAS matrix product.

``OPENBLAS_NUM_THREADS=16 python tests/benchmarks/coarse_solve.py`` on two cores shows a busy machine.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.multigrid.coarse_solve import dense_solve

_SECONDS = 0.5


def main() -> None:
    """Print both times for matrices of several sizes, in single and double precision."""
    for n in (100, 500, 1500):
        A = sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n))
        for dtype in (np.float64, np.float32):
            solve: Any = dense_solve(A, dtype)
            b = np.random.default_rng(0).normal(size=n).astype(dtype)
            ours, blas = cpu_seconds(partial(solve, b)), cpu_seconds(partial(np.matmul, solve.inverse, b))
            name = np.dtype(dtype).name
            print(f"{n} unknowns, {name}: {1e6 * ours:.0f} µs, BLAS {1e6 * blas:.0f} µs, {ours / blas:.2f}")


def cpu_seconds(call: Callable[[], Any]) -> float:
    """Return the mean CPU seconds of a call, of all threads, over half a second."""
    call()
    start, count = time.process_time(), 0
    while time.process_time() < start + _SECONDS:
        for _ in range(20):
            call()
        count += 20
    return (time.process_time() - start) / count


if __name__ == "__main__":
    main()
