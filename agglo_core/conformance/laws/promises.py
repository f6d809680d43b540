"""Laws for the promises of a component, also for bisectors returned by for_target."""

from __future__ import annotations

import pickle
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import frozen_int
from agglo_core.conformance.base import Broken, Case, Subject, law, require
from agglo_core.conformance.base.asking import for_target
from agglo_core.conformance.inputs.mesh_changes import MOTIONS, renumber_mesh, transform_mesh
from agglo_core.conformance.inputs.questions import answer, digest, plain, questions, same
from agglo_core.conformance.inputs.strategies import irregular_cases
from agglo_core.conformance.laws import laws_of
from agglo_core.conformance.laws.bisector import bisects
from agglo_core.conformance.process.fresh_import import import_again
from agglo_core.errors import AggloError
from agglo_core.protocols import Target
from agglo_core.registry.containment import PLUGIN_FAILURES


@law(promise="deterministic")
def deterministic(subject: Subject) -> None:
    """The result depends only on the input, not on the seed or on other calls."""
    tool, test_cases = subject.build(), questions(subject)
    first = [plain(subject, case, tool) for case in test_cases]
    second = [plain(subject, case, tool) for case in reversed(questions(subject, seed=1))]
    for case, a, b in zip(test_cases, first, reversed(second), strict=True):
        require(
            same(a, b),
            f"on {case.name}: with another seed, or after other calls, it answered differently: drop the "
            "promise deterministic if it draws random numbers",
        )


_CHANGES: Mapping[str, Mapping[str, Any]] = {
    **MOTIONS,
    "scaled by 1e-7": {"scale": 1e-7},
    "scaled by 1e7": {"scale": 1e7},
    "renumbered": {},
}


@law("bisector", "refiner", "fixer", draw=irregular_cases, promise="invariant", examples=8)
def invariant(subject: Subject, case: Case) -> None:
    """Renumbering, moving or scaling an asymmetric mesh changes no result (sides may be exchanged)."""
    before = plain(subject, case)
    assert case.mesh is not None
    for name, change in _CHANGES.items():
        mesh, order = transform_mesh(case.mesh, **change), frozen_int(np.arange(len(before)))
        if name == "renumbered":
            mesh, order = renumber_mesh(mesh)
        arguments = case.given[1:]
        if subject.kind != "bisector":
            arguments = (frozen_int(arguments[0][order]), *arguments[1:])
        after = plain(subject, replace(case, given=(mesh.graph, *arguments)))
        changed = np.count_nonzero(before[order] != after)
        if subject.kind == "bisector":
            changed = min(changed, np.count_nonzero(before[order] == after))
        require(
            not changed,
            f"on {case.name} {name}: {changed} of {len(after)} cells changed side: use distances and "
            "principal axes, and break ties by geometry, not numbering",
        )


@law(promise="pickles")
def pickles(subject: Subject) -> None:
    """The component can be pickled, for use in another process."""
    tool = subject.build()
    if subject.kind == "problem":
        for example in (answer(subject, case, tool) for case in questions(subject)):
            require(
                same(digest(_copy_by_pickle(example)), digest(example)),
                "the pickled example is another problem",
            )
        return
    copy = _copy_by_pickle(tool)
    for case in questions(subject):
        require(
            same(plain(subject, case, tool), plain(subject, case, copy)),
            f"on {case.name}: the pickled copy answers differently: keep all state in attributes",
        )


def _copy_by_pickle(thing: Any) -> Any:
    try:
        return pickle.loads(pickle.dumps(thing))
    except PLUGIN_FAILURES as error:
        raise Broken(
            f"pickling it raised {type(error).__name__}: {error}: no lambdas, files or locks in self"
        ) from error


_TARGETS = (
    *(Target(parts=parts) for parts in (2, 3, 5, 16, 400)),
    *(Target(h_star=size) for size in (1e-3, 0.03, 0.15, 0.5, 3.0, 8.0, 500.0)),
    *(Target(parts=16, h_star=size) for size in (0.03, 3.0)),
)
_WHEN_TOLD = (
    *("surroundings_kept", "side_array", "two_sides", "connected", "balanced", "same_seed_same_result"),
    *("a_level_is_its_blocks", "deterministic", "invariant", "space", "pickles"),
)
"""Laws for the bisectors that for_target returns."""


@law("bisector", when=lambda subject: bisects(subject) and subject.has("for_target"))
def told_the_target(subject: Subject) -> None:
    """Bisectors returned by for_target obey the laws and promises, unaffected by calls for other targets."""
    targets = []
    for target in _TARGETS:
        with suppress(AggloError):
            for_target(subject.build(), target)
            targets.append(target)
    require(targets, "for_target refuses every target, both counts and sizes: return self instead")
    _require_independent_targets(subject, targets)
    # The other laws, for some of the targets.
    rules = [rule for rule in laws_of("bisector") if rule.name in _WHEN_TOLD and rule.applies(subject)]
    for target in targets[:3] + targets[-4:-2]:
        tool = subject.build()
        for rule in rules if for_target(tool, target) is not tool else []:
            try:
                rule.judge(replace(subject, goal=target))
            except Broken as error:
                raise Broken(f"for {target}, {rule.name}: {error}", error.cause, error.code) from error


def _require_independent_targets(subject: Subject, targets: Sequence[Target]) -> None:
    """Require that ``for_target`` changes neither bisectors for other targets nor the object itself."""
    test_cases = questions(subject)

    def sides_of(tool: Any) -> list[NDArray[Any]]:
        return [plain(subject, case, tool) for case in test_cases]

    # Expected answers: from a freshly imported component for each target.
    expected = {}
    for target in targets:
        with import_again(subject) as unused:
            expected[target] = sides_of(for_target(unused.build(), target))
    # Compare with the answers of bisectors made by one object, for both orders of the targets.
    for order in (targets, targets[::-1]):
        tool = subject.build()
        before = sides_of(tool)
        for bisector, target in [(for_target(tool, target), target) for target in order]:
            require(
                all(map(same, sides_of(bisector), expected[target])),
                f"for {target} its answer changes once for_target was called for another target: key any "
                "cache by the whole target",
            )
        require(
            all(map(same, sides_of(tool), before)),
            "its answer changes after for_target was called for another target: return a new object, and "
            "leave self unchanged",
        )
