"""Call components with test cases, and examine results, exceptions and effects on the input."""

from __future__ import annotations

import hashlib
import random
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from agglo_core.conformance.base import Broken, Case, Subject, as_array, examples_of, require_array
from agglo_core.conformance.base.asking import ask
from agglo_core.conformance.base.tracing import component_frame
from agglo_core.conformance.inputs.cases import (
    ON_GRAPHS,
    cases,
    huge_case,
    kway_case,
    large_case,
    large_cases,
    seeds_for,
)
from agglo_core.conformance.inputs.drawn import SOLID
from agglo_core.conformance.inputs.speed import drop_slow_cases
from agglo_core.conformance.inputs.strategies import constraint_cases, graph_cases, metric_cases
from agglo_core.errors import AggloError
from agglo_core.graph import Graph
from agglo_core.problems import Solution
from agglo_core.registry.containment import PLUGIN_FAILURES

_CHOOSY = ("solver", "discretisation", "estimator", "format", "constraint")
_FORMS: Final[Mapping[str, tuple[str, str]]] = {
    "bisector": ("iubf", "one side for each cell"),
    "refiner": ("iub", "one label for each cell"),
    "fixer": ("iub", "one label for each cell"),
    "metric": ("iubf", "one number for each of the labels 0..k-1, not one per cell, not a mean"),
    "solver": ("iuf", "one number for each unknown"),
    "estimator": ("f", "one number for each cell"),
    "smoother": ("f", "return all of the new x, not a correction or matrix"),
    "coarse_solver": ("f", "one number for each unknown"),
}
"""Kinds with arrays for results: numbers as in :func:`require_array`, and their meaning."""

_OWN_PROBLEMS = ("diffusion", "linear")
_FEW = 10  # drawn cases of laws that compare several calls


REFUSED: Final = object()
"""Result of a component that refuses a test case, where that is allowed."""


def answer(subject: Subject, case: Case, tool: Any = None, *, refusal: Any = None) -> Any:
    """Call a component, built anew unless it is given, with a test case, and return the result unchecked.

    If a ``refusal`` is given, it is the result if the component raises an AggloError.

    Raises
    ------
    Broken
        If the component raises any other exception.
    """
    tool = subject.build() if tool is None else tool
    try:
        return ask(subject.kind, tool, case)
    except Broken:
        raise
    except PLUGIN_FAILURES as error:
        if isinstance(error, AggloError) and refusal is not None:
            return refusal
        cause = f"{type(error).__name__}: {error}" if _rejects_arguments(error) else ""
        raise Broken(f"on {case.name}: {_blame(subject, error)}", cause) from error


def strategy_for(subject: Subject, families: Sequence[str] | None = None) -> Any:
    """Return the hypothesis strategy of test cases, or None for kinds whose inputs are not drawn."""
    if subject.kind in ON_GRAPHS:
        return graph_cases(subject, families)
    if subject.kind == "metric":
        return metric_cases(subject, families)
    return constraint_cases(subject, families) if subject.kind == "constraint" else None


def questions(subject: Subject, seed: int = 0) -> list[Case]:
    """Return a few test cases for a component, except for categories that it refuses.

    A solver also gets the examples of further problem kinds in ``accepts``, and a bisector with direct
    partitions gets cases for these. A 3-D format that refuses all 2-D meshes gets the 3-D cases. A format
    that only reads gets none.
    """
    strategy = strategy_for(subject)
    test_cases = cases(subject.kind) if strategy is None else examples_of(strategy, _FEW)
    if subject.kind in ON_GRAPHS:
        test_cases += drop_slow_cases(subject, [large_case(subject.kind)])
        test_cases = [_with_seed(case, seed) for case in test_cases]
    test_cases = [*_with_partitions(subject, test_cases), *_further_problems(subject)]
    accepted_cases = select_accepted(subject, test_cases)
    if not accepted_cases and subject.kind == "format" and subject.promised("3d"):
        return select_accepted(subject, cases("format", "space"))
    return accepted_cases


def _with_partitions(subject: Subject, test_cases: list[Case]) -> list[Case]:
    """Add test cases for direct k-way partitions, if the component is a bisector that makes them."""
    if not subject.partitions:
        return test_cases
    whole = [case for case in test_cases if case.given[0].n_blocks == 1 < case.given[0].n]
    return test_cases + [kway_case(case, 2) for case in whole]


def _with_seed(case: Case, seed: int) -> Case:
    """Replace the random seeds of a test case for a bisector or refiner."""
    arguments = [
        seeds_for(len(value), seed) if getattr(value, "dtype", None) == np.uint64 else value
        for value in case.given
    ]
    return replace(case, given=tuple(arguments)) if seed else case


def large_graphs(subject: Subject) -> list[Case]:
    """Return the test cases on large graphs and many blocks for a bisector, refiner or fixer.

    A bisector without ``bisect_level`` is called once per block and gets fewer blocks, and so does a
    bisector with a fallback. Slow refiners and fixers get only small cases. Huge cases are for thorough
    checks.
    """
    huge = [huge_case(subject.kind)] if subject.thorough else []
    test_cases = drop_slow_cases(subject, [*large_cases(subject.kind), *huge])
    if subject.kind == "bisector" and (subject.fallback or not subject.has("bisect_level")):
        return [case for case in test_cases if case.given[0].n_blocks < 1000]
    return test_cases


def questions_in_3d(subject: Subject) -> list[Case]:
    """Return a few 3-D test cases for a component that accepts them, drawn where its inputs are drawn."""
    strategy = strategy_for(subject, SOLID)
    test_cases = cases(subject.kind, "space") if strategy is None else examples_of(strategy, _FEW)
    test_cases = _with_partitions(subject, test_cases)
    return with_suffix(subject, test_cases) if subject.kind == "format" else test_cases


def select_accepted(subject: Subject, test_cases: list[Case]) -> list[Case]:
    """Return the test cases that the component accepts.

    A solver may refuse a category (see :attr:`Case.sort`) with an AggloError on its first case; otherwise
    the solver must accept the whole category. A format may refuse meshes that cannot be represented, and a
    constraint may refuse graphs without the required data.
    """
    if subject.kind not in _CHOOSY:
        return test_cases
    if subject.kind == "format":
        test_cases = with_suffix(subject, test_cases)
    # Find the first case of each category, and drop the refused categories.
    first: dict[str, Case] = {}
    posed = subject.kind in ("solver", "discretisation")
    by_sort = [*cases(subject.kind), *_further_problems(subject)] if posed else test_cases
    for case in by_sort:
        first.setdefault(case.sort, case)
    refused = {sort for sort, case in first.items() if refuses(subject, case)}
    return [case for case in test_cases if case.sort not in refused]


def with_suffix(subject: Subject, standard: list[Case]) -> list[Case]:
    """Return the test cases of a file format, with the first suffix that the format can write.

    The list is empty for read-only formats.
    """
    if not subject.has("write"):
        return []
    suffixes = tuple(subject.suffixes)
    simple = cases("format")[0]
    candidates = (s for s in suffixes if not refuses(subject, _with_suffix(simple, s)))
    suffix = suffixes[0] if len(suffixes) == 1 else next(candidates, suffixes[0])
    return [_with_suffix(case, suffix) for case in standard]


def _with_suffix(case: Case, suffix: str) -> Case:
    return replace(case, given=(case.given[0], suffix))


def _further_problems(subject: Subject) -> list[Case]:
    """Return test cases for the problem kinds in ``accepts`` other than diffusion and linear systems."""
    if subject.kind not in ("solver", "discretisation"):
        return []
    accepts = getattr(subject.build(), "accepts", ())
    if isinstance(accepts, str):
        raise Broken(f"accepts is {accepts!r}, expected a tuple such as ('{accepts}',)")
    kinds = [kind for kind in accepts if kind not in _OWN_PROBLEMS]
    if not kinds:
        return []
    on = cases(subject.kind)[0].given[1]
    mesh = on if subject.kind == "discretisation" else on.fine
    examples = {kind: subject.problem(kind).example(mesh) for kind in kinds}
    return [Case(f"the example of problem {kind!r}", (it, on)) for kind, it in examples.items()]


def refuses(subject: Subject, case: Case) -> bool:
    """Return True if the component refuses a test case with an AggloError.

    The result is cached.
    """
    key = case.name, case.given[-1] if subject.kind == "format" else ""
    if key not in subject.cache:
        subject.cache[key] = False
        with suppress(Broken):  # another failure is no refusal
            subject.cache[key] = answer(subject, case, refusal=REFUSED) is REFUSED
    return bool(subject.cache[key])


def plain(subject: Subject, case: Case, tool: Any = None) -> NDArray[Any]:
    """Call a component, and return its result as an array (see :func:`in_array`)."""
    return in_array(subject, case, answer(subject, case, tool))


def in_array(subject: Subject, case: Case, result: Any) -> NDArray[Any]:
    """Return a result as an array: sides, labels, values or unknowns, else a hash."""
    if subject.kind not in _FORMS:
        return digest(result)
    values = require_form(subject, case, result)
    sides = subject.kind == "bisector" and len(case.given) == 2
    return values >= 0.5 if sides and values.dtype.kind == "f" else values


def require_form(subject: Subject, case: Case, result: Any) -> NDArray[Any]:
    """Return a result as an array, and require the form that its kind has in :data:`_FORMS`."""
    given, (numbers, remedy) = result.x if isinstance(result, Solution) else result, _FORMS[subject.kind]
    size = np.size(as_array(given)) if case.size is None else case.size
    return require_array(given, (size,), numbers, remedy, f"on {case.name}: it")


def digest(value: Any) -> NDArray[np.uint8]:
    """Return a hash of meshes, records, masks or texts as an array of bytes."""
    hasher = hashlib.sha256(repr(list(fingerprints(value))).encode())
    return np.frombuffer(hasher.digest(), np.uint8)


def same(one: NDArray[Any], other: NDArray[Any]) -> bool:
    """Return True if two arrays are equal, for floats up to 1e-9 times the largest absolute value."""
    if one.dtype.kind != "f" or one.shape != other.shape:
        return np.array_equal(one, other)
    scale = float(np.nanmax(np.abs(one), initial=0.0))  # NaN marks undefined values
    return bool(np.allclose(one, other, rtol=1e-9, atol=1e-9 * scale, equal_nan=True))


def chunks(level: Graph, values: NDArray[Any]) -> list[NDArray[Any]]:
    """Split an array of cell values into one array per block."""
    return np.split(values, level.offsets[1:-1])


def fingerprints(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield path and content of all data in the input of a component, to detect changes."""
    if isinstance(value, np.ndarray):
        yield path, (value.shape, value.dtype.str, value.tobytes())
    elif sparse.issparse(value):
        yield path, value.tocoo().toarray().tobytes()
    elif is_dataclass(value):
        for field in fields(value):
            yield from fingerprints(getattr(value, field.name), f"{path}.{field.name}".lstrip("."))
    elif isinstance(value, Mapping):
        yield path, tuple(map(str, value))
        for key, item in value.items():
            yield from fingerprints(item, f"{path}[{key!r}]")
    elif value is None or isinstance(value, str | int | float | np.generic):
        yield path, repr(value)
    elif isinstance(value, list | tuple):
        for place, item in enumerate(value):
            yield from fingerprints(item, f"{path}[{place}]")


@contextmanager
def global_random(seed: int) -> Iterator[Callable[[], bool]]:
    """Seed the global random generators of Python, numpy and torch, and restore them at the end.

    Yields a function that returns True while their states are unchanged.
    """
    torch = sys.modules.get("torch")

    def state() -> list[Any]:
        _, keys, *place = np.random.get_state()  # noqa: NPY002 - that state is what is being watched
        states = [random.getstate(), np.asarray(keys).tobytes(), place]
        return [*states, torch.get_rng_state().numpy().tobytes()] if torch else states

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


def _rejects_arguments(error: BaseException) -> bool:
    """Return True for the TypeError of a method that does not accept the arguments of the call."""
    return isinstance(error, TypeError) and (
        traceback.extract_tb(error.__traceback__)[-1].filename == ask.__code__.co_filename
    )


def _blame(subject: Subject, error: BaseException) -> str:
    """Describe an exception with the source line in the component, and its remedy."""
    if _rejects_arguments(error):
        return (
            f"it raised TypeError: {error}. Agglo could not call it: compare the arguments of its methods "
            "with the protocol of its kind in agglo_core.protocols"
        )
    frame = component_frame(subject, error) or traceback.extract_tb(error.__traceback__)[-1]
    text = f"it raised {type(error).__name__}: {error} ({frame.filename}:{frame.lineno})"
    if "read-only" in str(error):
        return (
            f"{text}. Input arrays are read-only because other code uses them too: change a copy (a = "
            "a.copy())"
        )
    return (
        f"{text}. An answer is required here: handle this case, or raise an AggloError that names the "
        "limitation"
    )
