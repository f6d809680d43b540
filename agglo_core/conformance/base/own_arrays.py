"""Writable copies of input arrays, and detection of even temporary changes to them during a call."""

from __future__ import annotations

import inspect
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from agglo_core.conformance.base.case import Case
from agglo_core.problems import Linear
from agglo_core.registry import KINDS


def in_own_arrays(case: Case) -> Case:
    """Replace the arrays in a test case by writable copies.

    Meshes and graphs stay read-only.
    """
    return replace(case, given=tuple(map(_own_copy, case.given)))


def arrays_in(case: Case) -> list[NDArray[Any]]:
    """Return the writable arrays among the arguments of a test case, including those of sparse matrices."""
    arrays: list[NDArray[Any]] = []
    for value in case.given:
        if isinstance(value, np.ndarray):
            arrays.append(value)
        elif isinstance(value, Linear):
            arrays += [value.b, value.A.data, value.A.indices, value.A.indptr]
    return [value for value in arrays if value.flags.writeable]


def _own_copy(value: Any) -> Any:
    if isinstance(value, Linear) and sparse.issparse(value.A) and hasattr(value.A, "indptr"):
        return replace(value, A=value.A.copy(), b=np.array(value.b))
    return np.array(value) if isinstance(value, np.ndarray) and value.dtype.kind in "if" else value


def home(kind: str, tool: Any) -> Path | None:
    """Return the folder of the component's Python module, or None for compiled code."""
    method = getattr(tool, KINDS[kind].methods[0])
    code = getattr(inspect.unwrap(getattr(method, "__func__", method)), "__code__", None)
    return None if code is None else Path(code.co_filename).parent


def find_writing_line(call: Callable[[], Any], folder: Path, watched: Sequence[NDArray[Any]]) -> int | None:
    """Run a call, and return the first source line number at which a watched array has changed.

    The call runs in a traced thread, and the arrays are compared before each line of the files in ``folder``.
    Return None if the arrays never change. Exceptions of the call propagate.
    """
    before, lines, errors = [array.copy() for array in watched], list[int](), list[BaseException]()
    inside: dict[str, bool] = {}

    # Trace function: compare the arrays before each line of a file in the folder.
    def compare_arrays(frame: FrameType, event: str, argument: Any) -> Any:
        name = frame.f_code.co_filename
        if not inside.setdefault(name, Path(name).parent == folder) or lines:
            return None
        if any((one != two).any() for one, two in zip(watched, before, strict=True)):
            lines.append(frame.f_lineno)
        return compare_arrays

    # Run the call in a thread with this trace function.
    def run_traced() -> None:
        sys.settrace(compare_arrays)
        try:
            call()
        except Exception as error:  # raised again below
            errors.append(error)
        finally:
            sys.settrace(None)

    thread = threading.Thread(target=run_traced)
    thread.start()
    thread.join()
    if errors:
        raise errors[0]
    return lines[0] if lines else None
