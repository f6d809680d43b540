"""Laws for the promises of a component, also for bisectors returned by for_target."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import Any

import numpy as np

from agglo_core.arrays import Int, frozen_int
from agglo_core.conformance.base.asking import for_target
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.drawing import drawn_law
from agglo_core.conformance.base.law import ASKED, law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import Broken, require
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.cases import cases_in_3d, seeds_for
from agglo_core.conformance.inputs.mesh_changes import MOTIONS, Change, renumber_mesh, transform_mesh
from agglo_core.conformance.inputs.questions import (
    answer,
    chunks,
    digest,
    large_graphs,
    plain,
    questions,
    same,
    same_labelling,
    select_accepted,
)
from agglo_core.conformance.inputs.speed import too_slow
from agglo_core.conformance.inputs.strategies import graph_cases
from agglo_core.conformance.laws import laws_of
from agglo_core.conformance.laws.bisector import has_for_target, one_sided
from agglo_core.conformance.laws.parts import in_more_pieces, loose_parts, same_parts
from agglo_core.errors import AggloError
from agglo_core.mesh import Mesh
from agglo_core.protocols import Target
from agglo_core.registry import KINDS
from agglo_core.registry.containment import PLUGIN_FAILURES

_IN_SPACE = {**MOTIONS, "scaled by 1e-7": Change(scale=1e-7), "scaled by 1e7": Change(scale=1e7)}


def _kinds_with_promise(promise: str) -> tuple[str, ...]:
    """Return the kinds of component that may make this promise, except samples."""
    return tuple(kind for kind in ASKED if promise in KINDS[kind].promises)


@law("bisector", promise="kway")
def kway_said(subject: Subject) -> None:
    """Only bisectors with a method partition promise kway."""
    require(subject.partitions, "it promises kway but has no method partition(graph, target, seed)")


@law("bisector", when=lambda subject: subject.partitions and subject.record is not None)
def kway_declared(subject: Subject) -> None:
    """A declared bisector with a method partition promises kway."""
    require(subject.promised("kway"), "it has a method partition: promise it, {'kway': True}")


@law(*_kinds_with_promise("deterministic"), promise="deterministic")
def deterministic(subject: Subject) -> None:
    """The result depends only on the input, not on the seed or on other calls."""
    tool = subject.build()
    test_cases = questions(subject)
    first = [plain(subject, tool, case) for case in test_cases]
    second = [plain(subject, tool, case) for case in reversed(questions(subject, seed=1))]
    for case, a, b in zip(test_cases, first, reversed(second), strict=True):
        require(
            same(a, b),
            f"on {case.name}: with another seed, or after other calls, it answered differently: drop the "
            "promise deterministic if it draws random numbers",
        )


@drawn_law("bisector", draw=graph_cases, fixed=large_graphs, promise="connected")
def connected(subject: Subject, case: Case) -> None:
    """Both sides of a connected graph are connected."""
    sides = plain(subject, subject.build(), case).astype(np.int64)
    pieces = max(loose_parts(case.given[0], sides).values())
    require(pieces == 1, f"on {case.name}: a side is in {pieces} pieces: drop the promise connected")


@drawn_law("bisector", draw=graph_cases, fixed=large_graphs, promise="balanced")
def balanced(subject: Subject, case: Case) -> None:
    """The weight share of a side differs from 1/2 by at most the promised tolerance plus one cell."""
    tolerance = subject.promised("balanced")
    max_deviation = 0.0 if tolerance is True or tolerance is None else float(tolerance)
    graph = case.given[0]
    sides = plain(subject, subject.build(), case)
    for weights, block_sides in zip(chunks(graph, graph.weights), chunks(graph, sides), strict=True):
        if not weights.sum() > 0.0:
            continue
        heaviest = float(weights.max() / weights.sum())
        deviation = abs(float(weights[block_sides == 1].sum() / weights.sum()) - 0.5)
        require(
            deviation <= max_deviation + heaviest + 1e-9,
            f"on {case.name}: the shares of the sides are {0.5 - deviation:.3f} and "
            f"{0.5 + deviation:.3f}, promised is 1/2 within {max_deviation:g} plus one cell "
            f"({heaviest:.3f}): promise a wider tolerance",
        )


@law("bisector", "refiner", "fixer", promise="invariant")
def invariant(subject: Subject) -> None:
    """Renumbering, rotating, scaling or shifting an asymmetric mesh (by 1e6 diameters) changes no result."""
    # Irregular grids; the large grid is only renumbered.
    every = small_meshes.CHANGES
    mesh_changes = [
        (small_meshes.grid(9, 7, jitter=0.25), every),
        (small_meshes.grid(14, 6, jitter=0.3), every),
    ]
    if too_slow(subject) is None:
        mesh_changes.append((small_meshes.grid(50, 40, jitter=0.3), every[:1]))
    if subject.kind == "fixer":
        mesh_changes += [(small_meshes.grid(8, 8), every)]  # with random labels, which break the symmetry
    if subject.promised("3d"):
        _require_unmoved_in_space(subject)
    # Compare the answers after each change, up to the exchange of sides.
    for mesh, changes in mesh_changes:
        before = [plain(subject, subject.build(), case) for case in _cases_on(subject.kind, mesh, mesh, None)]
        for change in changes:
            changed_mesh, order = small_meshes.change_mesh(mesh, change)
            for case, expected in zip(
                _cases_on(subject.kind, mesh, changed_mesh, order), before, strict=True
            ):
                result = plain(subject, subject.build(), case)
                require(
                    same_labelling(expected[order], result, swap=subject.kind == "bisector"),
                    f"on {mesh.name} {change}: {np.count_nonzero(expected[order] != result)} of "
                    f"{len(result)} cells changed side: use distances and principal axes; break ties by "
                    "geometry, not numbering",
                )


def _require_unmoved_in_space(subject: Subject) -> None:
    for solid in small_meshes.solids():
        before = [
            plain(subject, subject.build(), case) for case in _cases_on(subject.kind, solid, solid, None)
        ]
        changes = {name: (transform_mesh(solid, motion), None) for name, motion in _IN_SPACE.items()}
        for name, (mesh, order) in {**changes, "renumbered": renumber_mesh(solid)}.items():
            for case, values in zip(_cases_on(subject.kind, solid, mesh, order), before, strict=True):
                expected, after = (
                    values if order is None else values[order],
                    plain(subject, subject.build(), case),
                )
                require(
                    same_labelling(expected, after, swap=subject.kind == "bisector"),
                    f"on {solid.name} {name}: {np.count_nonzero(expected != after)} of {len(after)} cells "
                    "moved: use distances and principal axes in 3-D",
                )


@law(*_kinds_with_promise("3d"), promise="3d")
def space(subject: Subject) -> None:
    """In 3-D the result is as good as in 2-D: full length, finite, both sides, all parts."""
    test_cases = cases_in_3d(subject.kind)
    if subject.kind in ("solver", "format"):
        test_cases = select_accepted(subject, test_cases)
        require(test_cases or not subject.has("write"), "it refuses every 3-D mesh: drop the promise 3d")
    # One object answers a 2-D case first, to detect a stored dimension.
    tool = subject.build()
    for case in [*questions(subject)[:1], *test_cases]:  # starts with a 2-D case
        plain(subject, tool, case)
    for case in test_cases:
        values = plain(subject, subject.build(), case)
        second_values = plain(subject, tool, case)
        require(
            same(values, second_values),
            f"on {case.name}: its answer changes after a call on a 2-D mesh: keep no dimension in self",
        )
        if subject.kind != "metric":  # undefined values are allowed, and metrics have 3-D laws of their own
            require(np.isfinite(values).all(), f"on {case.name}: values are {values[:4]}")
        if subject.kind == "bisector":
            two_sided = len(one_sided(case.given[0], values)) == 0
            require(subject.fallback or two_sided, f"on {case.name}: all cells are on one side")
        if subject.kind in ("refiner", "fixer"):
            parts_equal = same_parts(case.given[0], case.given[1], values)
            require(parts_equal, f"on {case.name}: the set of labels changed in some block")
            worse = in_more_pieces(subject.kind, case.given[0], case.given[1], values)
            require(not worse, f"on {case.name}: {len(worse)} parts are in more pieces than allowed")


@law(*_kinds_with_promise("pickles"), promise="pickles")
def pickles(subject: Subject) -> None:
    """The component can be pickled, for use in another process."""
    tool = subject.build()
    if subject.kind == "problem":
        for example in (answer(subject, tool, case) for case in questions(subject)):
            require(
                same(digest(_copy_by_pickle(example)), digest(example)),
                "the pickled example is another problem",
            )
        return
    copy = _copy_by_pickle(tool)
    for case in questions(subject):
        require(
            same(plain(subject, tool, case), plain(subject, copy, case)),
            f"on {case.name}: the pickled copy answers differently: keep all state in attributes",
        )


def _copy_by_pickle(thing: Any) -> Any:
    try:
        return pickle.loads(pickle.dumps(thing))
    except PLUGIN_FAILURES as error:
        raise Broken(
            f"pickling it raised {type(error).__name__}: {error}: no lambdas, files or locks in self"
        ) from error


def _cases_on(kind: str, mesh: Mesh, changed_mesh: Mesh, order: Int | None) -> list[Case]:
    """Return test cases on ``changed_mesh``, with labels taken over from ``mesh`` where needed."""
    if kind == "bisector":
        return [Case(changed_mesh.name, (changed_mesh.graph, seeds_for(1)))]
    x, y = mesh.local_centroids.T[:2]
    rng = np.random.default_rng(1)
    scattered = [rng.integers(parts, size=len(x)) for parts in ((2, *[3] * 11) if kind == "fixer" else (2,))]
    labels = [x > 0.3 * y, (x > 0).astype(int) + 2 * (y > 0.1), *scattered]
    carried = [
        frozen_int(labelling if order is None else np.asarray(labelling)[order]) for labelling in labels
    ]
    if kind == "fixer":
        return [Case(changed_mesh.name, (changed_mesh.graph, labelling)) for labelling in carried]
    target = [Target(parts=int(labelling.max()) + 1) for labelling in carried]
    return [
        Case(changed_mesh.name, (changed_mesh.graph, labelling, seeds_for(1), t))
        for labelling, t in zip(carried, target, strict=True)
    ]


_TARGETS = (Target(parts=2), Target(parts=3), Target(parts=5), Target(h_star=0.3), Target(h_star=30.0))
_JUDGED = (
    "side_array",
    "side_values",
    "two_sides",
    "input_untouched",
    "same_seed_same_result",
    "global_random_state",
    "survives",
    "a_level_is_its_blocks",
    "deterministic",
    "connected",
    "balanced",
    "invariant",
    "space",
    "pickles",
)


@law("bisector", when=has_for_target)
def told_keeps_promises(subject: Subject) -> None:
    """Bisectors returned by for_target obey the laws for bisectors, and keep the original's promises."""
    rules = [rule for rule in laws_of("bisector") if rule.name in _JUDGED and rule.applies(subject)]
    for target in _TARGETS:
        tool = subject.build()
        try:
            if for_target(tool, target) is tool:
                continue
        except AggloError:  # the target is refused
            continue
        for rule in rules:
            try:
                rule.judge(replace(subject, told=target))
            except Broken as error:
                raise Broken(f"for {target}, {rule.name}: {error}", error.cause, error.code) from error
