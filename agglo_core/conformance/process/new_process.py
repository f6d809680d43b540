"""Answers of a component in another process: with other hash values, in another folder, and unpickled."""

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

from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.handing_over import environment, subject_from, task_of
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import Broken
from agglo_core.conformance.inputs.named_tags import with_tags
from agglo_core.conformance.inputs.questions import plain, questions, taken
from agglo_core.errors import AggloError
from agglo_core.registry.options import wants_registry

_LONGEST = 300.0  # seconds, with the time that imports and kernels take


def can_be_sent(subject: Subject) -> bool:
    """Whether another process can find it: not an object, nor one that needs what only this process has."""
    if subject.registry is not None and (subject.kind == "solver" or wants_registry(subject.target)):
        return False
    try:
        json.dumps(task_of(subject))
        return find_spec(str(subject.target.__module__)) is not None
    except (AggloError, TypeError, ValueError, ImportError, AttributeError):
        return False


def asked_elsewhere(subject: Subject) -> list[Case]:
    """The ordinary questions, and some about meshes with several tags."""
    return [*questions(subject), *taken(subject, with_tags(subject.kind))]


def answers_elsewhere(subject: Subject) -> dict[str, list[NDArray[Any]]]:
    """What it answers to the ordinary questions in a new process; Broken if it fails there.

    Once "built" there and, if it promises pickles, once "pickled" here. The other process has an empty
    current folder, unless options might name files in this one.
    """
    task = task_of(subject)
    if subject.promised("pickles"):
        task["pickled"] = base64.b64encode(pickle.dumps(subject.build())).decode()
    command = [sys.executable, "-c", "from agglo_core.conformance.process.new_process import main; main()"]
    other = "2" if os.environ.get("PYTHONHASHSEED") == "1" else "1"
    with TemporaryDirectory() as folder:
        try:
            done = subprocess.run(
                command,
                input=json.dumps(task),
                capture_output=True,
                text=True,
                timeout=_LONGEST,
                cwd=None if subject.options else folder,
                env=environment() | {"PYTHONHASHSEED": other},
            )
        except subprocess.TimeoutExpired:
            raise Broken(f"in another process it did not answer in {_LONGEST:g} seconds") from None
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["it left no message"])[-1]
        raise Broken(f"in another process, and in another folder, it failed: {last}")
    said: dict[str, Any] = json.loads(done.stdout)
    return {how: [np.array(values, dtype) for dtype, values in given] for how, given in said.items()}


def main() -> None:
    """Answer the questions to the component that stdin describes; whatever it prints goes to stderr."""
    with os.fdopen(os.dup(1), "w") as out:
        os.dup2(2, 1)
        task = json.loads(sys.stdin.read())
        subject = subject_from(task)
        given = {"built": subject}
        if "pickled" in task:  # before any other is built
            unpickled = pickle.loads(base64.b64decode(task["pickled"]))
            given = {"pickled": replace(subject, record=None, given=unpickled)} | given
        said = {how: _answers(each) for how, each in given.items()}
        json.dump({how: [(each.dtype.str, each.tolist()) for each in said[how]] for how in said}, out)


def _answers(subject: Subject) -> list[NDArray[Any]]:
    tool = subject.build()
    return [plain(subject, tool, case) for case in asked_elsewhere(subject)]
