"""Call a component in a child process with another hash seed, number of threads and current folder.

If the component promises pickling, a pickled object answers as well.
"""

from __future__ import annotations

import base64
import json
import os
import pickle
import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.conformance.base import Broken, Case, Subject
from agglo_core.conformance.base.handing_over import environment, subject_from, task_of
from agglo_core.conformance.inputs.cases import with_tags
from agglo_core.conformance.inputs.questions import plain, questions, select_accepted
from agglo_core.errors import AggloError
from agglo_core.registry.options import wants_registry

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_LONGEST = 300.0  # seconds, including imports and compilation


def can_be_sent(subject: Subject) -> bool:
    """Return True if another process can import the component.

    Objects are excluded, and components that need the registry of this process.
    """
    if subject.registry is not None and (subject.kind == "solver" or wants_registry(subject.target)):
        return False
    try:
        json.dumps(task_of(subject))
        return find_spec(str(subject.target.__module__)) is not None
    except (AggloError, TypeError, ValueError, ImportError, AttributeError):
        return False


def cases_elsewhere(subject: Subject) -> list[Case]:
    """Return the test cases for the child process: standard cases, and meshes with several tags."""
    return [*questions(subject), *select_accepted(subject, with_tags(subject.kind))]


def answers_elsewhere(subject: Subject) -> dict[str, list[NDArray[Any]]]:
    """Call a component with its test cases in a child process, and return the results.

    The results under ``"built"`` come from an object built there. If the component promises pickling, the
    results under ``"pickled"`` come from an object pickled here. The child process has an empty current
    folder, unless there are options: these may name files in the current folder.

    Raises
    ------
    Broken
        If the component fails in the child process.
    """
    # Describe the component, and pickle an object if that is promised.
    task = task_of(subject)
    if subject.promised("pickles"):
        task["pickled"] = base64.b64encode(pickle.dumps(subject.build())).decode()
    command = [sys.executable, "-c", "from agglo_core.conformance.process.new_process import main; main()"]
    # A different hash seed changes the order of sets and the hash of strings.
    changed = {"PYTHONHASHSEED": "2" if os.environ.get("PYTHONHASHSEED") == "1" else "1"}
    changed |= {name: "2" if os.environ.get(name) == "1" else "1" for name in _THREADS}
    with TemporaryDirectory() as folder:
        try:
            process = subprocess.run(
                command,
                input=json.dumps(task),
                capture_output=True,
                text=True,
                timeout=_LONGEST,
                cwd=None if subject.options else folder,
                env=environment() | changed,
            )
        except subprocess.TimeoutExpired:
            raise Broken(f"in another process it did not answer in {_LONGEST:g} seconds") from None
    if process.returncode:
        last = (process.stderr.strip().splitlines() or ["it left no message"])[-1]
        raise Broken(f"in another process, and in another folder, it failed: {last}")
    answers: dict[str, Any] = json.loads(process.stdout)
    return {
        source: [np.array(values, dtype) for dtype, values in arrays] for source, arrays in answers.items()
    }


def main() -> None:
    """Call the component described on stdin with its test cases, and print the results as JSON.

    Other output goes to stderr.
    """
    with os.fdopen(os.dup(1), "w") as stdout:
        os.dup2(2, 1)
        task = json.loads(sys.stdin.read())
        subject = subject_from(task)
        subjects = {"built": subject}
        if "pickled" in task:  # unpickle before another object is built
            unpickled = pickle.loads(base64.b64decode(task["pickled"]))
            subjects = {"pickled": replace(subject, record=None, given=unpickled)} | subjects
        answers = {source: _answers(item) for source, item in subjects.items()}
        json.dump(
            {source: [(item.dtype.str, item.tolist()) for item in answers[source]] for source in answers},
            stdout,
        )


def _answers(subject: Subject) -> list[NDArray[Any]]:
    tool = subject.build()
    return [plain(subject, case, tool) for case in cases_elsewhere(subject)]
