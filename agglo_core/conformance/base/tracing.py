"""Files and executed lines of the component under test."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any

from agglo_core.conformance.base.subject import Subject
from agglo_core.errors import PluginError


def files_of(subject: Subject) -> Callable[[str], bool]:
    """Return a function that is True for the file names of a component.

    All of a plugin's package is the component, but of agglo's package only the module itself.
    """
    try:
        target = subject.target
    except PluginError:  # its target cannot be imported
        return lambda name: False
    module = str(getattr(target, "__module__", type(target).__module__))
    top = module.partition(".")[0]
    files = [
        file
        for name in ([] if top == "agglo_core" else [top]) + [module]
        if (file := getattr(sys.modules.get(name), "__file__", None))
    ]
    if not files:
        return lambda name: False
    home = Path(files[0])
    home = home.parent if home.name == "__init__.py" else home
    return cache(lambda name: home in (Path(name), *Path(name).parents))


def component_frame(subject: Subject, error: BaseException) -> traceback.FrameSummary | None:
    """Return the last frame of an exception in the files of a component, or None outside."""
    inside = files_of(subject)
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if inside(frame.filename)]
    return frames[-1] if frames else None


def run_traced(subject: Subject, call: Callable[[], Any], at_line: Callable[[FrameType, str], None]) -> Any:
    """Run a call in a thread with a trace function for the component's files, and return the result.

    Exceptions of the call propagate.
    """
    inside = files_of(subject)

    def trace(frame: FrameType, event: str, argument: Any) -> Any:
        if not inside(frame.f_code.co_filename):
            return None
        at_line(frame, event)
        return trace

    def run() -> Any:
        sys.settrace(trace)
        try:
            return call()
        finally:
            sys.settrace(None)

    with ThreadPoolExecutor(1) as pool:
        return pool.submit(run).result()
