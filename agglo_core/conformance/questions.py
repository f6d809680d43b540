"""Putting a question to a component: its answer, its errors, and what it did to its input."""

from __future__ import annotations

import random
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from agglo_core.conformance.cases import Case, cases
from agglo_core.conformance.subject import Subject
from agglo_core.conformance.verdict import Broken
from agglo_core.errors import AggloError
from agglo_core.graph import Graph
from agglo_core.problems import Solution
from agglo_core.protocols import Target
from agglo_core.registry import KINDS
from agglo_core.registry.discovery import PLUGIN_FAILURES

__all__ = [
    "answer",
    "chunks",
    "fingerprints",
    "global_random",
    "in_words",
    "plain",
    "questions",
    "same",
    "settled",
    "taken",
]


def answer(subject: Subject, tool: Any, case: Case) -> Any:
    """What the component returns, as it is; whatever it raises becomes :class:`Broken`."""
    try:
        return _ask(subject.kind, tool, case)
    except Broken:
        raise
    except PLUGIN_FAILURES as error:
        raise Broken(f"on {case.name}: {_blame(subject, tool, error)}") from error


def questions(subject: Subject, seed: int = 0) -> list[Case]:
    """The ordinary questions to a component, less what a solver does not take."""
    return taken(subject, cases(subject.kind, seed))


def taken(subject: Subject, asked: list[Case]) -> list[Case]:
    """Of some questions, those that the component takes: all, unless it is a solver.

    A solver may refuse a sort of problem as a whole (see :attr:`Case.sort`): whether it does is seen by the
    first question of that sort, which it answers by an AggloError. What it takes in one case it must take in
    all.
    """
    if subject.kind != "solver":
        return asked
    first: dict[str, Case] = {}
    for case in cases("solver"):
        first.setdefault(case.sort, case)
    refused = {sort for sort, case in first.items() if _refuses(subject, case)}
    return [case for case in asked if case.sort not in refused]


def _refuses(subject: Subject, case: Case) -> bool:
    try:
        answer(subject, subject.build(), case)
    except Broken as error:
        return isinstance(error.__cause__, AggloError)
    return False


def plain(subject: Subject, tool: Any, case: Case) -> NDArray[Any]:
    """The answer as an array: sides as integers, labels, values, or the solution."""
    given = answer(subject, tool, case)
    values = np.asarray(given.x if isinstance(given, Solution) else given)
    if values.dtype.kind not in "iubf" or values.ndim != 1 or case.size not in (None, len(values)):
        raise Broken(f"on {case.name}: {in_words(given)} is no answer; see to the law above that says so")
    return values >= 0.5 if subject.kind == "bisector" and values.dtype.kind == "f" else values


def same(one: NDArray[Any], other: NDArray[Any]) -> bool:
    """Whether two answers are equal; floats to 1e-9 of the largest."""
    if one.dtype.kind != "f" or one.shape != other.shape:
        return np.array_equal(one, other)
    scale = float(np.abs(one).max(initial=0.0))
    return bool(np.allclose(one, other, rtol=1e-9, atol=1e-9 * scale, equal_nan=True))


def settled(before: NDArray[Any], after: NDArray[Any], swap: bool) -> bool:
    """Whether two labellings are equal, or with ``swap`` equal but for the names of two sides."""
    return np.array_equal(before, after) or (swap and np.array_equal(before, 1 - after.astype(np.int64)))


def chunks(level: Graph, values: NDArray[Any]) -> list[NDArray[Any]]:
    """Values of each block."""
    return np.split(values, level.offsets[1:-1])


def in_words(value: Any) -> str:
    """What a value is, shortly."""
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape} and {value.dtype}"
    return f"a {type(value).__name__} ({value!r:.40})"


def fingerprints(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Paths and contents of all that can be changed in a component's input."""
    if isinstance(value, np.ndarray):
        yield path, (value.shape, value.dtype.str, value.tobytes())
    elif sparse.issparse(value):
        yield path, value.tocoo().toarray().tobytes()
    elif is_dataclass(value):
        for each in fields(value):
            yield from fingerprints(getattr(value, each.name), f"{path}.{each.name}".lstrip("."))
    elif isinstance(value, Mapping):
        yield path, tuple(map(str, value))
        for key, item in value.items():
            yield from fingerprints(item, f"{path}[{key!r}]")
    elif isinstance(value, list | tuple):
        for place, item in enumerate(value):
            yield from fingerprints(item, f"{path}[{place}]")


@contextmanager
def global_random(seed: int) -> Iterator[Callable[[], bool]]:
    """Seed Python's, numpy's and torch's global generators for a while; gives whether they still stand."""
    torch = sys.modules.get("torch")

    def state() -> list[Any]:
        _, keys, *place = np.random.get_state()  # noqa: NPY002 - that state is what is being watched
        drawn = [random.getstate(), np.asarray(keys).tobytes(), place]
        return [*drawn, torch.get_rng_state().numpy().tobytes()] if torch else drawn

    before = random.getstate(), np.random.get_state(), torch.get_rng_state() if torch else None  # noqa: NPY002
    try:
        random.seed(seed)
        np.random.seed(seed)  # noqa: NPY002
        if torch:
            torch.manual_seed(seed)
        start = state()
        yield lambda: state() == start
    finally:
        random.setstate(before[0])
        np.random.set_state(before[1])  # noqa: NPY002
        if torch:
            torch.set_rng_state(before[2])


def _ask(kind: str, tool: Any, case: Case) -> Any:
    if kind != "bisector":
        return getattr(tool, KINDS[kind].methods[0])(*case.given)
    graph, seeds = case.given
    if hasattr(tool, "bisect_level"):
        return tool.bisect_level(graph, seeds)
    blocks = [graph[b] for b in range(graph.n_blocks)] if graph.n_blocks > 1 else [graph]
    if hasattr(tool, "bisect"):
        answers = [
            tool.bisect(block, np.random.default_rng(int(seed)))
            for block, seed in zip(blocks, seeds, strict=True)
        ]
    else:
        answers = [
            tool.partition(block, Target(parts=min(2, block.n)), int(seed))
            for block, seed in zip(blocks, seeds, strict=True)
        ]
    return answers[0] if len(answers) == 1 else np.concatenate([np.atleast_1d(a) for a in answers])


def _blame(subject: Subject, tool: Any, error: BaseException) -> str:
    """The error, the line of the component it came from, and what to do."""
    home = sys.modules.get(type(tool).__module__)
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if frame.filename == getattr(home, "__file__", None)] or frames
    where = f"{own[-1].filename}:{own[-1].lineno}"
    text = f"it raised {type(error).__name__}: {error} ({where})"
    if "read-only" in str(error):
        return f"{text}. Input arrays are read-only because others use them too: change a copy (a = a.copy())"
    return f"{text}. It must answer here: treat this case, or say in an AggloError what it cannot do"
