"""What is compiled before the first result: each function costs a user a few tenths of a second, once."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from numba.core import event

from agglo_core.kernels import helper

BENCHMARK = Path(__file__).parents[1] / "benchmarks" / "first_run.py"
README = "run voronoi:n=60,seed=3 --bisector kmeans --bisector metis -o out.vtu --plot out.png"


@helper
def twice(x: int) -> int:
    return 2 * x


def sum_of_doubles(values: Any) -> int:
    total = twice(21)  # a literal, which a kernel would be compiled for once more
    for value in values:
        total += twice(value)
    return total


class Compiled(event.Listener):
    """The names of the functions that numba compiles."""

    def __init__(self) -> None:
        self.names: Counter[str] = Counter()

    def on_start(self, event: Any) -> None:
        self.names[event.data["dispatcher"].py_func.__name__] += 1

    def on_end(self, event: Any) -> None:
        pass


def test_a_helper_is_compiled_once_for_literals_and_variables() -> None:
    listener = Compiled()
    with event.install_listener("numba:compile", listener):
        assert numba.njit(sum_of_doubles)(np.arange(4)) == 54  # not from the disk cache, as a kernel would be
    assert listener.names["twice"] == 1


def test_a_helper_stays_a_function_of_python() -> None:
    assert twice(4) == 8
    assert not hasattr(twice, "py_func")


@pytest.mark.slow
def test_readme_compiles_few_functions(tmp_path: Path) -> None:
    report = tmp_path / "compiled.json"
    subprocess.run(
        [sys.executable, str(BENCHMARK), str(report), *README.split()],
        env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")},
        cwd=tmp_path, check=True, capture_output=True,
    )  # fmt: skip
    names = [name for name, *_ in json.loads(report.read_text()) if name.startswith("agglo_")]
    assert 20 < len(names) <= 56, Counter(names).most_common()
    # a part that a kernel and another helper call is compiled for both; nothing is compiled three times
    assert max(Counter(names).values()) <= 2, Counter(names).most_common(5)
