"""Arrays owned by the caller: writable copies, and detection of temporary changes during a call."""

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
    """Return the case with writable copies of its arrays.

    Meshes and graphs stay read-only.
    """
    return replace(case, given=tuple(map(_own, case.given)))


def arrays_in(case: Case) -> list[NDArray[Any]]:
    """Return the writable arrays of a case, including the arrays of sparse matrices."""
    found: list[NDArray[Any]] = []
    for each in case.given:
        if isinstance(each, np.ndarray):
            found.append(each)
        elif isinstance(each, Linear):
            found += [each.b, each.A.data, each.A.indices, each.A.indptr]
    return [each for each in found if each.flags.writeable]


def _own(given: Any) -> Any:
    if isinstance(given, Linear) and sparse.issparse(given.A) and hasattr(given.A, "indptr"):
        return replace(given, A=given.A.copy(), b=np.array(given.b))
    return np.array(given) if isinstance(given, np.ndarray) and given.dtype.kind in "if" else given


def home(kind: str, tool: Any) -> Path | None:
    """Return the folder of the component's Python module, or None for compiled code."""
    method = getattr(tool, KINDS[kind].methods[0])
    code = getattr(inspect.unwrap(getattr(method, "__func__", method)), "__code__", None)
    return None if code is None else Path(code.co_filename).parent


def written_meanwhile(call: Callable[[], Any], folder: Path, watched: Sequence[NDArray[Any]]) -> int | None:
    """Return the first line number in ``folder`` at which a watched array has changed.

    The call runs in a traced thread, and the arrays are compared before each line in ``folder``. Return
    None if the arrays never change. Exceptions of the call propagate.
    """
    before, found, failed = [each.copy() for each in watched], list[int](), list[BaseException]()
    inside: dict[str, bool] = {}

    # Trace function: compare the arrays before each line of a file in the folder.
    def look(frame: FrameType, event: str, argument: Any) -> Any:
        name = frame.f_code.co_filename
        if not inside.setdefault(name, Path(name).parent == folder) or found:
            return None
        if any((one != two).any() for one, two in zip(watched, before, strict=True)):
            found.append(frame.f_lineno)
        return look

    # Run the call in a thread with this trace function.
    def traced() -> None:
        sys.settrace(look)
        try:
            call()
        except Exception as error:  # raised again below
            failed.append(error)
        finally:
            sys.settrace(None)

    thread = threading.Thread(target=traced)
    thread.start()
    thread.join()
    if failed:
        raise failed[0]
    return found[0] if found else None
