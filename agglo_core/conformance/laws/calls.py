"""Laws for sequences of calls, concurrent calls, blocks, and arrays of the caller."""

from __future__ import annotations

import gc
import os
import threading
import tracemalloc
import weakref
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import is_dataclass, replace
from functools import partial
from pathlib import Path
from types import FrameType, SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from agglo_core.arrays import Float, frozen_float
from agglo_core.conformance.base import Broken, Case, Subject, law, require
from agglo_core.conformance.base.tracing import run_traced
from agglo_core.conformance.inputs.cases import ON_GRAPHS, SIBLINGS, graph_case, part_of_level, siblings
from agglo_core.conformance.inputs.drawn import DrawnGraph, DrawnMesh
from agglo_core.conformance.inputs.multigrid_cases import PARTS
from agglo_core.conformance.inputs.questions import (
    answer,
    chunks,
    large_graphs,
    plain,
    questions,
    same,
    select_accepted,
)
from agglo_core.conformance.inputs.speed import drop_slow_cases
from agglo_core.conformance.inputs.strategies import graph_cases
from agglo_core.conformance.process.fresh_import import import_again
from agglo_core.graph import Graph
from agglo_core.mesh import Mesh
from agglo_core.problems import Linear

_ROUNDS = 2
_CALLS = 4  # calls per round; memory kept in all rounds is kept forever
_MOST_ROUNDS = 12  # maximum number of rounds while memory still grows
_KEPT_BYTES = 1500.0  # bytes allowed per call for caches of libraries; 600 integers take 4800
_STOPS = 4  # number of places at which a call is interrupted by another call
_WAIT = 0.3  # seconds to wait for the second call, which may be blocked by a lock


def _sibling_cases(subject: Subject) -> Iterator[Case]:
    """Yield the accepted cases of equal size, one at a time, so that each may reuse the previous memory.

    If all are refused, yield the standard test cases.
    """
    none = True
    for case in siblings(subject.kind, partition=subject.partitions):
        if select_accepted(subject, [case]):
            none = False
            yield case
    if none:
        yield from questions(subject)


@law(*SIBLINGS, *PARTS)
def nothing_carried_over(subject: Subject) -> None:
    """Other meshes of equal size, and other right-hand sides, change neither later nor earlier results."""
    # Expected answers: each from a freshly imported component.
    expected = []
    for case in _sibling_cases(subject):
        with import_again(subject) as unused:
            expected.append(plain(unused, case))
    # A single object must give these answers, in several rounds over all cases.
    tool, results = subject.build(), []
    for _ in range(_ROUNDS):
        for case, right in zip(_sibling_cases(subject), expected, strict=True):
            result = plain(subject, case, tool)
            require(
                same(result, right),
                f"on {case.name}: its answer changes after calls on other meshes of the same size: key a "
                "cache by all the data that determine the answer, not by the number of cells or id()",
            )
            results.append((case.name, result, result.copy()))
            del case
    if subject.kind in ("smoother", "coarse_solver"):
        results += _answers_of_one_function(subject)
    for name, result, before in results:
        require(
            np.array_equal(result, before, equal_nan=before.dtype.kind == "f"),
            f"on {name}: the array it returned was changed by a later call: return a new one, not an array "
            "kept in self or in the function of b",
        )


_PREPARING = {"smoother": "setup", "coarse_solver": "solver_for", "constraint": "for_mesh"}
"""Methods that prepare an object for a level, matrix or mesh."""


def _prepared(subject: Subject, tool: Any, case: Case) -> Any:
    """Return a component that always returns the object prepared for one test case."""
    method = _PREPARING[subject.kind]
    made = getattr(tool, method)(case.given[0])
    return SimpleNamespace(**{method: lambda _: made})


def _answers_of_one_function(subject: Subject) -> list[tuple[str, Any, Any]]:
    """Return results of the function for one matrix with two right-hand sides, and copies made at once."""
    case = next(_sibling_cases(subject))
    matrix, *vectors = case.given
    one_function = _prepared(subject, subject.build(), case)
    results = []
    for factor in (1.0, -2.0):
        given = (matrix, *(frozen_float(factor * vector) for vector in vectors))
        x = plain(subject, replace(case, given=given), one_function)
        results.append((case.name, x, x.copy()))
    return results


@law(*_PREPARING, when=lambda subject: subject.has(_PREPARING[subject.kind]))
def prepared_apart(subject: Subject) -> None:
    """Later calls of ``setup``, ``solver_for`` or ``for_mesh`` do not affect the objects returned before."""
    tool, test_cases = subject.build(), questions(subject)
    prepared = [_prepared(subject, tool, case) for case in test_cases]
    for case, one in zip(test_cases, prepared, strict=True):
        alone = plain(subject, case)
        with suppress(Broken):  # an exception differs, too
            if same(plain(subject, case, one), alone):
                continue
        raise Broken(
            f"on {case.name}: the result differs if {_PREPARING[subject.kind]} was called for other input "
            "meanwhile: return a new object, and keep its data in it, not in self"
        )


@law(*SIBLINGS)
def in_two_threads(subject: Subject) -> None:
    """A call that starts while another call is running disturbs neither of them."""
    case, *others = _sibling_cases(subject)
    alone, lines = _interrupted_answers(subject, case, case, 0)
    # The second call starts at some of the lines of the first call.
    for meanwhile in others[:1] + others[-1:]:
        expected = [*alone, np.array(plain(subject, meanwhile))]
        for stop in sorted({int(line) for line in np.linspace(1, lines, _STOPS)} - {0}):
            results, _ = _interrupted_answers(subject, case, meanwhile, stop)
            require(
                all(map(same, results, expected)),
                f"on {case.name}: its answer changes if another call starts meanwhile: pass the data of a "
                "call between methods as arguments instead of keeping them in self",
            )


def _interrupted_answers(
    subject: Subject, first: Case, second: Case, stop: int
) -> tuple[list[NDArray[Any]], int]:
    """Answer a case, and a second one in another thread from the ``stop``-th line of the component on.

    Return the results, and the number of lines that the first call executed.
    """
    lines, started, tool = 0, list[Future[Any]](), subject.build()

    def copied_answer(case: Case) -> NDArray[Any]:
        return np.array(plain(subject, case, tool))

    def start_second(_: FrameType, event: str) -> None:
        nonlocal lines
        lines += event == "line"
        if event == "line" and lines == stop:
            started.append(pool.submit(copied_answer, second))
            wait(started, timeout=_WAIT)

    with ThreadPoolExecutor(1) as pool:
        try:
            result = run_traced(subject, partial(copied_answer, first), start_second)
            return [result, *(call.result() for call in started)], lines
        except Broken as error:
            raise Broken(f"while another call was under way: {error}") from error


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
        alive = [any(reference() is not None for reference in of_call) for of_call in references]
        memory, files, threads = _growth_per_call(subject, tool)
    finally:
        gc.unfreeze()
    require(not all(alive), f"the input or answer of {len(alive)} calls is still in memory: {remedy}")
    require(memory <= _KEPT_BYTES, f"each call leaves {memory:.0f} bytes behind: {remedy}")
    require(files < 1, f"each call leaves {files:.0f} files open: use with open(…)")
    require(threads < 1, f"each call leaves {threads:.0f} threads running: {remedy}")


def _call_for_references(subject: Subject, tool: Any) -> list[Any]:
    """Call the component, and return weak references to the input and its arrays."""
    case = next(_sibling_cases(subject))
    answer(subject, case, tool)
    things = [value for value in case.given if isinstance(value, np.ndarray) or is_dataclass(value)]
    arrays = [attribute for value in things for attribute in getattr(value, "__dict__", {}).values()]
    return [
        weakref.ref(value) for value in [*things, *arrays] if isinstance(value, np.ndarray | Graph | Mesh)
    ]


def _growth_per_call(subject: Subject, tool: Any) -> Float:
    """Return the least growth of memory in bytes, open files and threads per call, over several rounds.

    The rounds end when a round adds nothing. Free lists and bounded caches fill during the first rounds,
    which takes longer if a component makes many internal calls. Leaked memory grows in every round.
    """
    case = next(_sibling_cases(subject))
    if subject.kind in ON_GRAPHS:
        sizable = graph_case(subject.kind, DrawnGraph(DrawnMesh(cells=600, jitter=0.25)), "grown", 20)
        case = next(iter(drop_slow_cases(subject, [sizable])), case)
    least, before = np.full(3, np.inf), np.full(3, -np.inf)
    tracemalloc.start()
    try:
        for number in range(_MOST_ROUNDS):
            for _ in range(_CALLS):
                answer(subject, case, tool)
            gc.collect()
            usage = tracemalloc.get_traced_memory()[0], _open_files(), threading.active_count()
            growth, before = (np.array(usage) - before) / _CALLS, np.array(usage, float)
            if number > 1:
                least = np.minimum(least, growth)
                if (growth <= (_KEPT_BYTES, 0, 0)).all():
                    break
    finally:
        tracemalloc.stop()
    return least


def _open_files() -> int:
    """Return the number of open files of this process, or 0 if the system does not report it."""
    folder = Path("/proc/self/fd")
    return len(os.listdir(folder)) if folder.is_dir() else 0


def _levels(subject: Subject) -> Any:
    return graph_cases(subject, blocks=(5, 2, 40), tagged=True)


@law("bisector", "refiner", "fixer", draw=_levels, fixed=large_graphs, examples=25)
def a_level_is_its_blocks(subject: Subject, case: Case) -> None:
    """The result of a block does not depend on other blocks, their sizes or their order."""
    graph, tool = case.given[0], subject.build()
    remedy = (
        "take sums, extremes and scales within each block (graph.block_ids, graph.offsets), never over the "
        "whole level, and keep nothing from the previous block"
    )
    together = chunks(graph, plain(subject, case, tool))
    # A few blocks alone, among them the largest.
    for block in {*range(0, graph.n_blocks, -(-graph.n_blocks // 5)), int(graph.sizes.argmax())}:
        alone = plain(subject, _move_other_points(part_of_level(case, [block])))
        require(
            same(alone, together[block]),
            f"a block of {len(alone)} cells has a different result alone than in the level: {remedy}",
        )
    # Some of the blocks in another order.
    order = np.random.default_rng(3).permutation(graph.n_blocks)[:20]
    shuffled = part_of_level(case, order)
    for block, part in zip(order, chunks(shuffled.given[0], plain(subject, shuffled, tool)), strict=True):
        require(
            same(part, together[block]),
            f"a block of {len(part)} cells has a different result in another order of blocks: {remedy}",
        )


def _move_other_points(case: Case) -> Case:
    """Move the points outside the blocks of a test case onto a point of its blocks.

    The graph still holds the points of the whole level.
    """
    graph, *arguments = case.given
    point_indices = np.unique(graph.vertices)
    points = np.repeat(graph.points[point_indices[:1]], len(graph.points), axis=0)
    points[point_indices] = graph.points[point_indices]
    return Case(case.name, (replace(graph, points=frozen_float(points)), *arguments))


_MOST_VALUES = 200  # larger cases test nothing new


@law("refiner", "fixer", "metric", "solver", "smoother")
def never_written(subject: Subject) -> None:
    """Given arrays are never changed, not even temporarily, and are read anew in each call."""
    small = [case for case in questions(subject) if (case.size or 0) <= _MOST_VALUES]
    owned = [copy for case in small if _arrays_in(copy := _in_own_arrays(case))]
    for case in owned[-4:]:
        tool = subject.build()
        line = _writing_line(subject, tool, case)
        require(
            line is None,
            f"on {case.name}: the given arrays or the matrix are changed temporarily (line {line}): other "
            "threads that read them get wrong results; work on a copy",
        )
        for _ in range(3):
            require(
                same(plain(subject, case, tool), plain(subject, _in_own_arrays(case))),
                f"on {case.name}, with other values in the same arrays: its answer differs from that of a "
                "fresh object: the same array object may hold other values, so never key a cache by id()",
            )
            _overwrite(case)


def _in_own_arrays(case: Case) -> Case:
    """Replace the arrays in a test case, except in meshes and graphs, by writable copies."""

    def own_copy(value: Any) -> Any:
        if isinstance(value, Linear) and sparse.issparse(value.A) and hasattr(value.A, "indptr"):
            return replace(value, A=value.A.copy(), b=np.array(value.b))
        return np.array(value) if isinstance(value, np.ndarray) and value.dtype.kind in "if" else value

    return replace(case, given=tuple(map(own_copy, case.given)))


def _arrays_in(case: Case) -> list[NDArray[Any]]:
    """Return the writable arrays among the arguments of a test case, including those of sparse matrices."""
    arrays: list[NDArray[Any]] = []
    for value in case.given:
        if isinstance(value, np.ndarray):
            arrays.append(value)
        elif isinstance(value, Linear):
            arrays += [value.b, value.A.data, value.A.indices, value.A.indptr]
    return [value for value in arrays if value.flags.writeable]


def _writing_line(subject: Subject, tool: Any, case: Case) -> int | None:
    """Return the first line of the component at which a given array has changed, or None."""
    watched, lines = [(array, array.copy()) for array in _arrays_in(case)], list[int]()

    def compare_arrays(frame: FrameType, _: str) -> None:
        if not lines and any((array != before).any() for array, before in watched):
            lines.append(frame.f_lineno)

    run_traced(subject, partial(answer, subject, case, tool), compare_arrays)
    return lines[0] if lines else None


def _overwrite(case: Case) -> None:
    """Overwrite the arrays of a test case: reverse them, move a cell to another part, double a matrix."""
    problem = case.given[0]
    if isinstance(problem, Linear):
        problem.b[:] = problem.b[::-1].copy()
        problem.A.data *= 2.0
        return
    for array in _arrays_in(case):
        array[:] = array[::-1].copy()
        if array.dtype.kind == "i":
            movable = np.flatnonzero((np.bincount(array)[array] > 1) & (array != array[0]))
            array[movable[:1]] = array[0]
