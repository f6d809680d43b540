"""Compile the kernels listed in ``ahead_of_time.txt``, while a wheel is built or beside a first run.

python -m agglo_core.compiled.ahead_of_time FOLDER LEVEL ...
"""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numba.types

from agglo_core.compiled.cpu_levels import LEVELS

LISTED = Path(__file__).with_name("ahead_of_time.txt")
# Maximum number of processes: more compile in parallel, but each loads numba, which costs time and memory
# (benchmarks/first_run.py --wheel).
_MOST_WORKERS = 16
_SHARE = f"from {__name__} import compile_share; compile_share({{}}, {{}})"
_MOST_BESIDE = 2  # beside a first run, which compiles the dearest kernel, a third of the time of all


class Signature(NamedTuple):
    """A kernel to compile: its module, its name, and its argument types in numba's notation."""

    module: str
    name: str
    arguments: str

    def kernel(self) -> Any:
        """Import and return the kernel, which compiles nothing."""
        return getattr(import_module(self.module), self.name)

    def types(self) -> tuple[Any, ...]:
        """Return the argument types as numba objects."""
        names = {**vars(numba.types), "bool": numba.types.boolean, "named": _named_tuple}
        found: tuple[Any, ...] = eval(self.arguments, names)  # from a file in this package
        return found


def write_types(arguments: tuple[Any, ...]) -> str:
    """Convert numba's argument types to text that :meth:`Signature.types` can parse."""
    texts = []
    for argument in arguments:
        if isinstance(argument, numba.types.NamedTuple | numba.types.NamedUniTuple):
            home = argument.instance_class
            texts.append(f"named({write_types(argument.types)}, '{home.__module__}:{home.__qualname__}')")
        else:
            texts.append(repr(argument))
    return f"({', '.join(texts)},)"


def _named_tuple(types: tuple[Any, ...], home: str) -> Any:
    module, name = home.split(":")
    made: Any = numba.types.BaseTuple.from_types  # no annotations in numba
    return made(types, getattr(import_module(module), name))


def read_signatures() -> list[Signature]:
    """Read the kernels and argument types in ``ahead_of_time.txt``, slowest to compile first."""
    lines = LISTED.read_text(encoding="utf-8").splitlines()
    return [Signature(*line.split(" ", 2)) for line in lines if not line.startswith("#")]


def compile_listed(folder: Path, signatures: Iterable[Signature], level: str) -> list[str]:
    """Compile the given kernels in one process per processor, and return a line for each failure.

    The machine code is for processors of a ``level`` (``cpu_levels.py``). Set NUMBA_CACHE_DIR to an empty
    folder, because kernels called by other kernels are stored there.
    """
    if level not in LEVELS:
        return [f"unknown processor level {level!r}: expected one of {', '.join(LEVELS)}"]
    # New processes: in a forked one numba may have chosen this processor already.
    new = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(_processors(), _MOST_WORKERS), new, _prepare, (level,)) as pool:
        waiting = {pool.submit(_compile, each, folder): each for each in signatures}
        ended = [(waiting[each], each.exception()) for each in as_completed(waiting)]
    return [f"{one.module}.{one.name}: {error}" for one, error in ended if error is not None]


def _prepare(level: str) -> None:
    settings: Any = numba.config
    settings.CPU_NAME, settings.CPU_FEATURES = level, ""


def _compile(signature: Signature, folder: Path) -> None:
    kernel = signature.kernel()
    kernel._cache.write_to(folder)
    kernel.compile(signature.types())


def start_workers() -> list[subprocess.Popen[bytes]]:
    """Start processes on the other processors that compile listed kernels into the cache of this user.

    None starts where the cache cannot be written.
    """
    from agglo_core.compiled.sums import slice_sums

    count = min(_processors() - 1, _MOST_BESIDE) if slice_sums._cache.cache_path is not None else 0
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    workers = []
    for k in range(count):
        with suppress(OSError):  # no process can be started: the run compiles everything by itself
            workers.append(
                subprocess.Popen(
                    [sys.executable, "-P", "-c", _SHARE.format(k, count)], env=environment,
                    stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                )
            )  # fmt: skip
    return workers


def compile_share(first: int, step: int) -> None:
    """Compile each ``step``-th listed kernel of the core, from the given one on, into the cache.

    Kernels of plugins are left out: not every run needs them, and those that do need them early.
    """
    core = [signature for signature in read_signatures() if signature.module.startswith("agglo_core.")]
    for signature in core[first::step]:
        signature.kernel().compile(signature.types())


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def main(folder: Path, levels: list[str]) -> list[str]:
    """Compile all listed kernels for the given levels, and return a line for each failure."""
    signatures = read_signatures()
    return [line for each in levels for line in compile_listed(folder, signatures, each)]


if __name__ == "__main__":
    sys.exit("\n".join(main(Path(sys.argv[1]), sys.argv[2:])) or None)
