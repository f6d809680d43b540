"""Laws for repeated, concurrent and failing calls, for blocks, and for arrays of the caller."""

from __future__ import annotations

import contextlib
import gc
import io
import os
import sys
import threading
import tracemalloc
import weakref
from collections.abc import Callable, Iterator, Sequence
from dataclasses import is_dataclass, replace
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float, frozen_float
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.own_arrays import arrays_in, find_writing_line, home, in_own_arrays
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.surroundings import Snapshot, enter_empty_folder, stdout_of_process
from agglo_core.conformance.base.verdict import Broken, require
from agglo_core.conformance.inputs.cases import cases, level_case, part_of_level
from agglo_core.conformance.inputs.early_ends import early_ends
from agglo_core.conformance.inputs.hard_cases import SIBLINGS, crowd_case, large_cases, many_parts, siblings
from agglo_core.conformance.inputs.multigrid_cases import PARTS
from agglo_core.conformance.inputs.questions import (
    answer,
    chunks,
    fingerprints,
    global_random,
    in_space,
    plain,
    questions,
    same,
    select_accepted,
)
from agglo_core.conformance.inputs.speed import drop_slow_cases, too_slow
from agglo_core.conformance.process.fresh_import import import_again
from agglo_core.graph import Graph
from agglo_core.mesh import Mesh
from agglo_core.problems import Linear, Solution

_ROUNDS = 3
_CALLS = 4  # calls per round; memory kept in all rounds is kept forever
_MOST_ROUNDS = 12  # maximum number of rounds while memory still grows
_SIZABLE = 600  # cells of the mesh that must not stay in memory
_KEPT_BYTES = 1500.0  # bytes allowed per call for caches of libraries; 600 integers take 4800
_STOPS = 4  # number of places at which a call is interrupted by another call
_WAIT = 0.3  # seconds to wait for the second call, which may be blocked by a lock


def _sibling_cases(subject: Subject) -> list[Case]:
    """Return the accepted test cases of equal size, which a wrong cache would confuse.

    If all are refused, return the standard test cases.
    """
    return list(_each_sibling_case(subject))


@law(*SIBLINGS, *PARTS)
def nothing_carried_over(subject: Subject) -> None:
    """Calls on other meshes of equal size in between change no result: no cache confuses them."""
    # Expected answers: each from a freshly imported component.
    names = [case.name for case in _sibling_cases(subject)]
    expected = []
    for place in range(len(names)):
        with import_again(subject) as unused, global_random(1):
            expected.append(plain(unused, unused.build(), _sibling_cases(subject)[place]))
    # A single object must give these answers, in several rounds over all cases.
    tool = subject.build()
    for _ in range(_ROUNDS):
        for place, case in enumerate(_each_sibling_case(subject)):
            with global_random(1):
                result = plain(subject, tool, case)
            require(
                same(result, expected[place]),
                f"on {case.name}: its answer changes after calls on other meshes of the same size: key a "
                "cache by all the data that determine the answer, not by the number of cells or id()",
            )
            del case, result


def _each_sibling_case(subject: Subject) -> Iterator[Case]:
    """Yield the test cases of equal size one at a time, so that each may reuse the previous memory."""
    none = True
    for case in siblings(subject.kind, partition=subject.partitions):
        if select_accepted(subject, [case]):
            none = False
            yield case
    if none:
        yield from questions(subject)


@law(*SIBLINGS)
def answers_stay(subject: Subject) -> None:
    """Later calls leave the results of earlier calls unchanged."""
    tool, records = subject.build(), []
    for case in _sibling_cases(subject):
        returned = answer(subject, tool, case)
        values = returned.x if isinstance(returned, Solution) else returned
        records.append((case.name, values, np.array(values, copy=True)))
    for name, values, before in records:
        require(
            np.array_equal(values, before, equal_nan=before.dtype.kind == "f"),
            f"on {name}: the array it returned was changed by a later call: return a new one, not an array "
            "kept in self",
        )


@law(*SIBLINGS)
def in_two_threads(subject: Subject) -> None:
    """A call that starts while another call is running disturbs neither of them."""
    few_cases = _sibling_cases(subject)
    # Count the lines of the first call, and choose some at which the second call starts.
    home = getattr(sys.modules.get(type(subject.build()).__module__), "__file__", None)
    lines = _Stepper(home, 0, lambda: None)
    first = lines.run(lambda: _copy_answer(subject, subject.build(), few_cases[0]))
    stops = sorted({int(line) for line in np.linspace(1, lines.count, _STOPS)} - {0})
    for meanwhile in few_cases[1:2] + few_cases[-1:]:
        expected = [first, _copy_answer(subject, subject.build(), meanwhile)]
        for stop in stops:
            answers = _nest_calls(subject, (few_cases[0], meanwhile), home, stop)
            require(
                all(map(same, answers, expected)),
                f"on {few_cases[0].name}: its answer changes if another call starts meanwhile: pass the "
                "data of a call between methods as arguments instead of keeping them in self",
            )


def _nest_calls(subject: Subject, case_pair: Sequence[Case], file: str | None, stop: int) -> list[Any]:
    """Run two calls of one object at the same time, and return both results.

    The second call starts when the first call reaches the ``stop``-th executed line of a file.
    """
    tool, inner = subject.build(), list[Any]()
    stepper = _Stepper(file, stop, lambda: inner.append(_copy_answer(subject, tool, case_pair[1])))
    return [stepper.run(lambda: _copy_answer(subject, tool, case_pair[0])), *inner]


def _copy_answer(subject: Subject, tool: Any, case: Case) -> Any:
    return np.array(plain(subject, tool, case), copy=True)


class _Stepper:
    """Run a call in a thread, and start a second call at the ``stop``-th executed line of a file."""

    def __init__(self, file: str | None, stop: int, other: Callable[[], Any]) -> None:
        self.file, self.stop, self.other, self.count = file, stop, other, 0
        self.threads: list[threading.Thread] = []

    def run(self, call: Callable[[], Any]) -> Any:
        """Run the first call, and return its result.

        Exceptions of both calls are raised here.
        """
        results: list[Any] = []
        errors: list[BaseException] = []

        # Run work in this thread, with or without tracing, and keep its result or its error.
        def guarded(work: Callable[[], Any], keep: Callable[[Any], None], *, traced: bool) -> None:
            try:
                sys.settrace(self._trace if traced else None)
                keep(work())
            except Exception as error:  # raised again below
                errors.append(error)
            finally:
                sys.settrace(None)

        def second() -> None:
            guarded(self.other, lambda _: None, traced=False)

        self.second = second
        # Run the first call under the trace function, then wait for both calls.
        first = threading.Thread(target=guarded, args=(call, results.append), kwargs={"traced": True})
        first.start()
        first.join()
        for thread in self.threads:
            thread.join()
        if errors:
            error = errors[0]
            raise Broken(f"while another call was under way: {error}") from error
        return results[0]

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
    """No input or result is kept after a call: memory, open files and threads do not accumulate."""
    tool = subject.build()
    remedy = "keep nothing of a call in self, in the class or in the module"
    gc.freeze()  # so that later collections only visit objects of the calls
    try:
        # Objects: weak references to the input of several calls must expire.
        references = [_call_for_references(subject, tool) for _ in range(_CALLS + 2)]
        gc.collect()
        alive = [
            any(reference() is not None for reference in call_references) for call_references in references
        ]
        usage = _measure_usage(subject, tool)
    finally:
        gc.unfreeze()
    require(not all(alive), f"the input or answer of {len(alive)} calls is still in memory: {remedy}")
    # Resources: the smallest growth over the rounds must be negligible.
    growth = _growth_per_call(usage).min(axis=0)
    require(growth[0] <= _KEPT_BYTES, f"each call leaves {growth[0]:.0f} bytes behind: {remedy}")
    require(growth[1] < 1, f"each call leaves {growth[1]:.0f} files open: use with open(…)")
    require(growth[2] < 1, f"each call leaves {growth[2]:.0f} threads running: {remedy}")


def _measure_usage(subject: Subject, tool: Any) -> Float:
    """Repeat a call in rounds, and return memory in bytes, open files and threads after each round.

    The rounds end when a round adds nothing. Free lists and bounded caches fill during the first rounds,
    which takes longer if a component makes many internal calls. Leaked memory grows in every round.
    """
    sizable = drop_slow_cases(subject, [case for case in _sizable(subject.kind) if case.size == _SIZABLE])
    case, usage = next(iter(sizable or _each_sibling_case(subject))), list[tuple[int, int, int]]()
    tracemalloc.start()
    try:
        while len(usage) < 3 or (len(usage) < _MOST_ROUNDS and not _has_settled(usage)):
            for _ in range(_CALLS):
                answer(subject, tool, case)
            gc.collect()
            usage.append((tracemalloc.get_traced_memory()[0], _open_files(), threading.active_count()))
    finally:
        tracemalloc.stop()
    return np.array(usage, float)


def _sizable(kind: str) -> list[Case]:
    return large_cases(kind) if kind in ("bisector", "refiner", "fixer") else []


def _growth_per_call(usage: ArrayLike) -> Float:
    """Return the growth of memory, files and threads per call, in each round except the first."""
    return np.diff(usage, axis=0)[1:] / _CALLS


def _has_settled(usage: ArrayLike) -> bool:
    """Return True if memory, files and threads hardly grew in the last round."""
    return bool((_growth_per_call(usage)[-1] <= (_KEPT_BYTES, 0, 0)).all())


def _call_for_references(subject: Subject, tool: Any) -> list[Any]:
    """Call the component, and return weak references to the input and its arrays."""
    case = next(_each_sibling_case(subject))
    answer(subject, tool, case)
    things = [value for value in case.given if isinstance(value, np.ndarray) or is_dataclass(value)]
    arrays = [attribute for value in things for attribute in getattr(value, "__dict__", {}).values()]
    return [
        weakref.ref(value) for value in [*things, *arrays] if isinstance(value, np.ndarray | Graph | Mesh)
    ]


def _open_files() -> int:
    """Return the number of open files of this process, or 0 if the system does not report it."""
    folder = Path("/proc/self/fd")
    return len(os.listdir(folder)) if folder.is_dir() else 0


@law("bisector", "refiner", "fixer")
def a_level_is_its_blocks(subject: Subject) -> None:
    """The result of a block does not depend on other blocks, their sizes or their order."""
    levels = [
        (level_case(subject.kind), (0, 1, 2, 30, 60)),
        (crowd_case(subject.kind, 40), (0, 3, 9, 20, 21, 39)),
    ]
    if subject.kind == "bisector" and subject.has("bisect_level"):
        levels.append((many_parts(subject.kind), (3, 0, 255, 4095, 4097, 4999)))
    levels += [(case, (0, 1, 2)) for case in in_space(subject) if case.given[0].n_blocks == 3]
    for case, blocks in levels if too_slow(subject) is None else [_few_blocks(levels[0][0])]:
        _require_independent_blocks(subject, case, blocks)


def _move_other_points(case: Case) -> Case:
    """Move the points outside the blocks of a test case onto a point of its blocks.

    The graph still holds the points of the whole level.
    """
    graph, *arguments = case.given
    point_indices = np.unique(graph.vertices)
    points = np.repeat(graph.points[point_indices[:1]], len(graph.points), axis=0)
    points[point_indices] = graph.points[point_indices]
    return Case(case.name, (replace(graph, points=frozen_float(points)), *arguments))


def _few_blocks(level: Case) -> tuple[Case, Sequence[int]]:
    """Restrict a test case to twelve small blocks for slow components, and select three of them."""
    return part_of_level(level, np.arange(1, 13)), (0, 3, 11)


def _require_independent_blocks(subject: Subject, case: Case, blocks: Sequence[int]) -> None:
    """Require equal results for blocks alone, and among up to 21 blocks in another order."""
    graph = case.given[0]
    remedy = (
        "take sums, extremes and scales within each block (graph.block_ids, graph.offsets), never over the "
        "whole level, and keep nothing from the previous block"
    )
    # The whole level, then each chosen block alone.
    tool = subject.build()
    together = chunks(graph, plain(subject, tool, case))
    for block in blocks:
        alone = plain(subject, subject.build(), _move_other_points(part_of_level(case, [block])))
        require(
            same(alone, together[block]),
            f"a block of {len(alone)} cells has a different result alone than in a level: {remedy}",
        )
    # A random selection of blocks in random order.
    other_blocks = np.random.default_rng(3).permutation(np.delete(np.arange(graph.n_blocks), blocks[0]))
    order = np.insert(other_blocks[:20], min(7, len(other_blocks)), blocks[0])
    shuffled = part_of_level(case, order)
    for block, part in zip(order, chunks(shuffled.given[0], plain(subject, tool, shuffled)), strict=True):
        require(
            same(part, together[block]),
            f"a block of {len(part)} cells has a different result in another order of blocks: {remedy}",
        )


_OWNED = ("refiner", "fixer", "metric", "solver", "smoother")
"""Kinds with array arguments besides meshes and graphs, which are read-only."""

_FEW = 200  # maximum number of values in a case; larger cases test nothing new


def _small_cases(subject: Subject) -> list[Case]:
    ordinary = {case.name for case in cases(subject.kind)}
    test_cases = [case for case in questions(subject) if case.name in ordinary and (case.size or 0) <= _FEW]
    return [copy for case in test_cases[::-1] if arrays_in(copy := in_own_arrays(case))][:4]


@law(*_OWNED)
def never_written(subject: Subject) -> None:
    """Given arrays are never changed, not even temporarily: other threads may read them."""
    for case in _small_cases(subject):
        tool = subject.build()
        folder = home(subject.kind, tool)
        if folder is None:
            return
        line = find_writing_line(partial(answer, subject, tool, case), folder, arrays_in(case))
        require(
            line is None,
            f"on {case.name}: the given arrays or the matrix are changed temporarily (line {line}): other "
            "threads that read them get wrong results; work on a copy",
        )


@law(*_OWNED)
def read_anew(subject: Subject) -> None:
    """If the caller overwrites an array between two calls, the second call uses the new values."""
    for case in _small_cases(subject):
        tool = subject.build()
        for _ in range(3):
            with global_random(1):
                result = plain(subject, tool, case)
            with global_random(1):
                expected = plain(subject, subject.build(), in_own_arrays(case))
            require(
                same(result, expected),
                f"on {case.name}, with other values in the same arrays: its answer differs from that of a "
                "fresh object: the same array object may hold other values, so never key a cache by id()",
            )
            _change(case)


def _change(case: Case) -> None:
    """Overwrite the arrays of a test case: reverse them, move a cell to another part, double a matrix."""
    problem = case.given[0]
    if isinstance(problem, Linear):
        problem.b[:] = problem.b[::-1].copy()
        problem.A.data *= 2.0
        return
    for array in arrays_in(case):
        array[:] = array[::-1].copy()
        if array.dtype.kind == "i":
            movable = np.flatnonzero((np.bincount(array)[array] > 1) & (array != array[0]))
            array[movable[:1]] = array[0]


_KINDS = ("bisector", "refiner", "fixer", "metric", "solver", "smoother", "constraint", *PARTS)


@law(*_KINDS)
def ends_early_without_trace(subject: Subject) -> None:
    """Calls that are refused, fail or have nothing to do change no setting, and print and write nothing."""
    remedy = "a with block (np.errstate) or finally restores settings on every exit path"
    for case in early_ends(subject.kind):
        digests, before, printed = dict(fingerprints(case.given)), Snapshot(), io.StringIO()
        with (
            enter_empty_folder() as folder,
            stdout_of_process() as read_output,
            contextlib.redirect_stdout(printed),
        ):
            with global_random(1) as unmoved:
                with contextlib.suppress(Broken):
                    answer(subject, subject.build(), case)
                random_kept = unmoved()
            text = printed.getvalue() or read_output().decode(errors="replace")
            new_files = sorted(path.name for path in folder.iterdir())
        changed = before.changed()
        before.restore()
        require(not changed, f"on {case.name}: it changed {', '.join(changed)}: {remedy}")
        require(
            not text, f"on {case.name}: it printed {text!r:.60}: put this text into the error or the reason"
        )
        require(random_kept, f"on {case.name}: it drew from, or seeded, the global random state")
        require(
            not new_files,
            f"on {case.name}: it left {', '.join(new_files)} in the current folder: write no files",
        )
        after = dict(fingerprints(case.given))
        require(digests == after, f"on {case.name}: it changed its input: work on a copy")
