"""Process settings that components must not change, recorded before and after each call."""

from __future__ import annotations

import builtins
import ctypes
import gc
import locale
import logging
import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Any, NamedTuple

import numpy as np


class _Setting(NamedTuple):
    """Process setting, such as the current folder, with its getter and, where possible, its setter."""

    read: Callable[[], Any]
    write: Callable[[Any], object] | None = None
    by_imports: bool = False  # imported libraries may change the setting


def _set_environment(values: Mapping[str, str]) -> None:
    os.environ.clear()
    os.environ.update(values)


def _set_filters(values: tuple[Any, ...]) -> None:
    warnings.filters[:] = values  # type: ignore[index]


_set_locale = partial(locale.setlocale, locale.LC_ALL)  # without argument it returns the locale


def _logging_state() -> list[Any]:
    loggers = (logging.getLogger(), logging.getLogger("agglo"))
    of_loggers = [(log.level, log.disabled, len(log.handlers), log.propagate) for log in loggers]
    return [*of_loggers, logging.root.manager.disable]


def _numba_threads() -> int | None:
    parallel = sys.modules.get("numba.np.ufunc.parallel")
    started = parallel is not None and getattr(parallel, "_is_initialized", False)
    return int(parallel.get_num_threads()) if parallel is not None and started else None


def _torch_state() -> list[Any] | None:
    torch = sys.modules.get("torch")
    if torch is None:
        return None
    return [torch.get_num_threads(), str(torch.get_default_dtype()), torch.is_grad_enabled()]


_SETTINGS: Mapping[str, _Setting] = {
    "the floating-point error handling (np.seterr)": _Setting(np.geterr, lambda old: np.seterr(**old)),
    "the print options of numpy": _Setting(
        lambda: {key: value for key, value in np.get_printoptions().items() if key != "override_repr"},
        lambda old: np.set_printoptions(**old),
    ),
    "environment variables": _Setting(lambda: dict(os.environ), _set_environment, by_imports=True),
    "the current folder": _Setting(os.getcwd, os.chdir),
    "the warning filters": _Setting(lambda: tuple(warnings.filters), _set_filters, by_imports=True),
    "signal handlers": _Setting(lambda: [repr(signal.getsignal(i)) for i in sorted(signal.valid_signals())]),
    "alarms": _Setting(lambda: signal.getitimer(signal.ITIMER_REAL)[0] > 0),
    "the locale": _Setting(_set_locale, _set_locale),
    "the recursion limit": _Setting(sys.getrecursionlimit, sys.setrecursionlimit),
    "the thread switch interval": _Setting(sys.getswitchinterval, sys.setswitchinterval),
    "the garbage collector": _Setting(lambda: (gc.isenabled(), gc.get_threshold())),
    "logging": _Setting(_logging_state, by_imports=True),
    "sys.path": _Setting(lambda: tuple(sys.path), by_imports=True),
    "the streams and hooks of sys": _Setting(
        lambda: [id(each) for each in (sys.stdout, sys.stderr, sys.excepthook, sys.displayhook)]
    ),
    "tracing": _Setting(lambda: (sys.gettrace(), sys.getprofile())),
    "built-in functions": _Setting(  # the prompt sets _
        lambda: {name: id(value) for name, value in vars(builtins).items() if name != "_"}
    ),
    "the threads of numba": _Setting(_numba_threads, by_imports=True),
    "the settings of torch": _Setting(_torch_state, by_imports=True),
}


class Snapshot:
    """Values of all process settings at one moment."""

    def __init__(self) -> None:
        self._values = {name: setting.read() for name, setting in _SETTINGS.items()}
        self._modules = len(sys.modules)

    def changed(self) -> list[str]:
        """List the settings that have changed since the snapshot.

        If modules were imported since the snapshot, settings that imports may change are excluded.
        """
        imported = len(sys.modules) > self._modules
        return [
            name
            for name, setting in _SETTINGS.items()
            if not (imported and setting.by_imports) and setting.read() != self._values[name]
        ]

    def restore(self) -> None:
        """Reset every setting that can be written to its value in the snapshot."""
        for name, setting in _SETTINGS.items():
            if setting.write is not None and setting.read() != self._values[name]:
                setting.write(self._values[name])


@contextmanager
def enter_empty_folder() -> Iterator[Path]:
    """Make an empty temporary folder the current folder, and return to the previous one at the end.

    Yields the path as reported by the system, without symbolic links.
    """
    before = os.getcwd()
    with TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            yield Path.cwd()
        finally:
            os.chdir(before)


@contextmanager
def stdout_of_process() -> Iterator[Callable[[], bytes]]:
    """Capture the standard output of the process (file descriptor 1), including output of compiled code.

    Yields a function that returns the captured bytes.
    """
    sys.stdout.flush()
    _flush_c()
    saved_fd = os.dup(1)
    try:
        with TemporaryFile() as buffer:
            os.dup2(buffer.fileno(), 1)

            def read_output() -> bytes:
                _flush_c()
                buffer.seek(0)
                return buffer.read()

            try:
                yield read_output
            finally:
                os.dup2(saved_fd, 1)
    finally:
        os.close(saved_fd)


def _flush_c() -> None:
    """Flush the C library's output buffers."""
    with suppress(OSError, AttributeError, TypeError):  # TypeError: the main program is no library
        ctypes.CDLL(None).fflush(None)
