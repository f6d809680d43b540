"""Laws of what was asked before, and meanwhile: none of it may show in an answer, or stay in memory."""

from __future__ import annotations

import gc
import os
import sys
import threading
import tracemalloc
import weakref
from collections.abc import Callable, Iterator, Sequence
from dataclasses import is_dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import Broken, require
from agglo_core.conformance.inputs.hard_cases import SIBLINGS, siblings, unusual_cases
from agglo_core.conformance.inputs.questions import answer, global_random, plain, questions, same, taken
from agglo_core.conformance.inputs.speed import bearable
from agglo_core.conformance.process.fresh_import import imported_again
from agglo_core.graph import Graph
from agglo_core.mesh import Mesh
from agglo_core.problems import Solution

_ROUNDS = 3
_CALLS = 4  # in each of some rounds: what is kept in all of them is kept for ever
_MOST_ROUNDS = 12  # while each leaves something in memory
_SIZABLE = 600  # cells of the mesh of which nothing may stay in memory
_KEPT_BYTES = 1500.0  # may stay after a call, as libraries note this and that; 600 integers have 4800
_STOPS = 4  # places at which a call is interrupted by another
_WAIT = 0.3  # seconds that other call is waited for: one that holds a lock must let it wait


def _few(subject: Subject) -> list[Case]:
    """Questions easily taken for one another, less what the component refuses; if it is all, the ordinary."""
    return list(_each(subject))


@law(*SIBLINGS)
def nothing_carried_over(subject: Subject) -> None:
    """Questions in between, about other meshes of the same size, change no answer: no cache mistakes them."""
    names = [case.name for case in _few(subject)]
    expected = []
    for place in range(len(names)):
        with imported_again(subject) as unused, global_random(1):
            expected.append(plain(unused, unused.build(), _few(subject)[place]))
    tool = subject.build()
    for _ in range(_ROUNDS):
        for place, case in enumerate(_each(subject)):
            with global_random(1):
                given = plain(subject, tool, case)
            require(
                same(given, expected[place]),
                f"on {case.name}: it answers otherwise after questions about meshes of the same size: a "
                "cache must be keyed by all that decides, not by the number of cells or id()",
            )
            del case, given


def _each(subject: Subject) -> Iterator[Case]:
    """The same questions one at a time, so that each may lie in memory where the one before has been."""
    none = True
    for case in siblings(subject.kind, partition=subject.partitions):
        if taken(subject, [case]):
            none = False
            yield case
    if none:
        yield from questions(subject)


@law(*SIBLINGS)
def answers_stay(subject: Subject) -> None:
    """An answer it gave stays as it is while it gives the next ones."""
    tool, given = subject.build(), []
    for case in _few(subject):
        returned = answer(subject, tool, case)
        values = returned.x if isinstance(returned, Solution) else returned
        given.append((case.name, values, np.array(values, copy=True)))
    for name, values, before in given:
        require(
            np.array_equal(values, before, equal_nan=before.dtype.kind == "f"),
            f"on {name}: the array it returned was changed by a later call: return a new one, not an array "
            "kept in self",
        )


@law(*SIBLINGS)
def in_two_threads(subject: Subject) -> None:
    """A call that begins while another has not ended disturbs neither."""
    few = _few(subject)
    home = getattr(sys.modules.get(type(subject.build()).__module__), "__file__", None)
    lines = _Stepper(home, 0, lambda: None)
    first = lines.run(lambda: _seeded(subject, subject.build(), few[0]))
    stops = sorted({int(line) for line in np.linspace(1, lines.count, _STOPS)} - {0})
    for meanwhile in few[1:2] + few[-1:]:
        expected = [first, _seeded(subject, subject.build(), meanwhile)]
        for stop in stops:
            answers = _interrupted(subject, (few[0], meanwhile), home, stop)
            require(
                all(map(same, answers, expected)),
                f"on {few[0].name}: it answers otherwise if another call begins meanwhile: pass what a call "
                "needs from method to method instead of keeping it in self",
            )


def _interrupted(subject: Subject, asked: Sequence[Case], file: str | None, stop: int) -> list[Any]:
    """The answers to two questions to one object, the second put while the first is at a line of a file."""
    tool, inner = subject.build(), list[Any]()
    stepper = _Stepper(file, stop, lambda: inner.append(_seeded(subject, tool, asked[1])))
    return [stepper.run(lambda: _seeded(subject, tool, asked[0])), *inner]


def _seeded(subject: Subject, tool: Any, case: Case) -> Any:
    return np.array(plain(subject, tool, case), copy=True)


class _Stepper:
    """Runs a call in a thread and, before its line number ``stop`` of a file, another in a second thread."""

    def __init__(self, file: str | None, stop: int, other: Callable[[], Any]) -> None:
        self.file, self.stop, self.other, self.count = file, stop, other, 0
        self.threads: list[threading.Thread] = []

    def run(self, call: Callable[[], Any]) -> Any:
        """What the call returns; whatever either of them raises is raised here."""
        found: list[Any] = []
        failed: list[BaseException] = []

        def guarded(work: Callable[[], Any], keep: Callable[[Any], None], *, traced: bool) -> None:
            try:
                sys.settrace(self._trace if traced else None)
                keep(work())
            except Exception as error:  # raised again below
                failed.append(error)
            finally:
                sys.settrace(None)

        def second() -> None:
            guarded(self.other, lambda _: None, traced=False)

        self.second = second
        first = threading.Thread(target=guarded, args=(call, found.append), kwargs={"traced": True})
        first.start()
        first.join()
        for thread in self.threads:
            thread.join()
        if failed:
            error = failed[0]
            raise Broken(f"while another call was under way: {error}") from error
        return found[0]

    def _trace(self, frame: FrameType, event: str, argument: Any) -> Any:
        if frame.f_code.co_filename != self.file:
            return None
        if event == "line":
            self.count += 1
            if self.count == self.stop:
                thread = threading.Thread(target=self.second)
                self.threads.append(thread)
                thread.start()
                thread.join(_WAIT)
        return self._trace


@law(*SIBLINGS)
def lets_go(subject: Subject) -> None:
    """It keeps neither what it was given nor what it answered: memory, files and threads do not add up."""
    tool = subject.build()
    remedy = "keep nothing of a call in self, in the class or in the module"
    gc.freeze()  # so that to collect what the calls leave is quick
    try:
        given = [_given_once(subject, tool) for _ in range(_CALLS + 2)]
        gc.collect()
        kept = [any(each() is not None for each in once) for once in given]
        held = _held(subject, tool)
    finally:
        gc.unfreeze()
    require(not all(kept), f"what it was given in {len(kept)} calls is still in memory: {remedy}")
    grown = _grown(held).min(axis=0)
    require(grown[0] <= _KEPT_BYTES, f"each call leaves {grown[0]:.0f} bytes behind: {remedy}")
    require(grown[1] < 1, f"each call leaves {grown[1]:.0f} files open: use with open(…)")
    require(grown[2] < 1, f"each call leaves {grown[2]:.0f} threads running: {remedy}")


def _held(subject: Subject, tool: Any) -> Float:
    """Bytes, open files and threads after each round of the same question; rounds end when one adds nothing.

    Free lists and caches of a bounded size fill in the first rounds, the more calls a component makes
    within itself the longer; what is kept for ever grows in every round.
    """
    sizable = bearable(subject, [case for case in unusual_cases(subject.kind) if case.size == _SIZABLE])
    case, held = next(iter(sizable or _each(subject))), list[tuple[int, int, int]]()
    tracemalloc.start()
    try:
        while len(held) < 3 or (len(held) < _MOST_ROUNDS and not _settled(held)):
            for _ in range(_CALLS):
                answer(subject, tool, case)
            gc.collect()
            held.append((tracemalloc.get_traced_memory()[0], _open_files(), threading.active_count()))
    finally:
        tracemalloc.stop()
    return np.array(held, float)


def _grown(held: ArrayLike) -> Float:
    """How much each round but the first added, per call."""
    return np.diff(held, axis=0)[1:] / _CALLS


def _settled(held: ArrayLike) -> bool:
    """Whether the last round added nothing worth a complaint."""
    return bool((_grown(held)[-1] <= (_KEPT_BYTES, 0, 0)).all())


def _given_once(subject: Subject, tool: Any) -> list[Any]:
    """Weak references to what the component was given in a call, and to the arrays in it."""
    case = next(_each(subject))
    answer(subject, tool, case)
    things = [each for each in case.given if isinstance(each, np.ndarray) or is_dataclass(each)]
    arrays = [value for each in things for value in getattr(each, "__dict__", {}).values()]
    return [weakref.ref(each) for each in [*things, *arrays] if isinstance(each, np.ndarray | Graph | Mesh)]


def _open_files() -> int:
    """Open files of this process; 0 where the system does not tell."""
    folder = Path("/proc/self/fd")
    return len(os.listdir(folder)) if folder.is_dir() else 0
