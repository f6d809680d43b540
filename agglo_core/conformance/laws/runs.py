"""Laws for complete agglomeration runs, child processes and large meshes.

These laws are judged last, because failures of earlier laws are easier to read.
"""

from __future__ import annotations

import time

import numpy as np

from agglo_core.agglomeration.border import broken_blocks
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.drawing import drawn_law
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.own_components import own_components
from agglo_core.conformance.base.running import runs_both_ways, runs_with
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import Broken, require
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.cases import labelled_case, seeds_for, stripes
from agglo_core.conformance.inputs.hard_cases import SIBLINGS
from agglo_core.conformance.inputs.questions import answer, global_random, plain, same
from agglo_core.conformance.inputs.strategies import run_cases
from agglo_core.conformance.inputs.unusual_graphs import clumps
from agglo_core.conformance.laws.bisector import one_sided
from agglo_core.conformance.laws.parts import in_more_pieces, same_parts
from agglo_core.conformance.process.new_process import answers_elsewhere, can_be_sent, cases_elsewhere
from agglo_core.errors import AggloError, OptionError
from agglo_core.graph import Graph, functionals
from agglo_core.measure.agglomerates import quality

_LONGER = 1.25
"""Largest interface of grown parts relative to parts made depth by depth; small meshes vary a little."""


@drawn_law("bisector", "refiner", "fixer", "metric", draw=run_cases, examples=25)
def works_in_a_run(subject: Subject, case: Case) -> None:
    """Runs for a target count or size give connected parts as requested, and metrics can measure parts."""
    mesh, target = case.given
    try:
        if subject.kind == "metric":
            labels = stripes(mesh.graph, 3)
            quality(mesh, labels, metrics=[subject.build()], registry=own_components())
            return
        for description, hierarchy in runs_with(subject, mesh, target):
            for reached, parts in zip(hierarchy.targets, hierarchy.parts, strict=True):
                require(reached.get("n_parts", parts) == parts, f"a run {description} gave {parts} parts")
            for labels in hierarchy.levels:
                loose = broken_blocks(hierarchy.graph, labels)
                require(not len(loose), f"a run {description} gave parts in pieces")
    except AggloError as error:
        if isinstance(error, OptionError) and "h_factor" in target and subject.has("for_target"):
            return  # for_target may refuse a size
        raise Broken(f"on {case.name} with {target}: a run with it failed: {error}") from error


def _grows(subject: Subject) -> bool:
    return subject.has("grow") and (subject.has("bisect") or subject.has("bisect_level"))


@law("bisector", when=_grows)
def grows_alike(subject: Subject) -> None:
    """Parts made by ``grow`` are as good as parts made by the bisector's own splits depth by depth."""
    try:
        for description, grow_hierarchy, split_hierarchy in runs_both_ways(subject):
            for labels, usual_labels in zip(grow_hierarchy.levels, split_hierarchy.levels, strict=True):
                cut, usual_cut = (
                    functionals.cut(grow_hierarchy.graph, parts, edge_weights=grow_hierarchy.graph.interface)
                    for parts in (labels, usual_labels)
                )
                require(
                    cut <= _LONGER * usual_cut,
                    f"{description}: parts made by grow have an interface of {cut:.4g}, those made depth by "
                    f"depth of {usual_cut:.4g}: use the same splits in both, and decline unknown components",
                )
    except AggloError as error:
        raise Broken(f"a run with it failed: {error}") from error


@law(*SIBLINGS, when=can_be_sent)
def same_in_another_process(subject: Subject) -> None:
    """Another process with other hash values, threads and current folder gives equal results."""
    test_cases, tool = cases_elsewhere(subject), subject.build()
    with global_random(1):
        expected = [plain(subject, tool, case) for case in test_cases]
    remedy = {
        "built": "hash() of a string, id(), the order of a set, the number of threads, and files in the "
        "current folder differ there",
        "pickled": "keep all state in attributes, not in the module",
    }
    for source, answers in answers_elsewhere(subject).items():
        for case, a, b in zip(test_cases, expected, answers, strict=True):
            require(
                same(a, b),
                f"on {case.name}: {source} for another process, it gives a different answer there: "
                f"{remedy[source]}",
            )


_SMALL, _LARGE, _LARGER = (50, 40), (100, 80), (200, 160)  # cells along x and y
_HUGE = (300, 250)  # the cell count exceeds 16 bits, its square 32 bits
_STEEP = 1.7  # exponent of the cell count; n log n is about 1.1, quadratic is 2
_NOTICEABLE = 0.5  # CPU seconds on the larger mesh; faster components always pass


def _is_thorough(subject: Subject) -> bool:
    return subject.thorough


@law("bisector", "refiner", "fixer", when=_is_thorough)
def large_meshes(subject: Subject) -> None:
    """On 75,000 cells the result is as good as on few: both sides, all parts, none in more components."""
    case = _case(subject.kind, _HUGE)
    graph = case.given[0]
    values = plain(subject, subject.build(), case)
    if subject.kind == "bisector":
        two_sided = not len(one_sided(graph, values))
        require(two_sided or subject.fallback, f"on {case.name}: all cells are on one side")
        return
    labels = case.given[1]
    require(same_parts(graph, labels, values), f"on {case.name}: the set of labels changed in some block")
    worse = in_more_pieces(subject.kind, graph, labels, values)
    require(not worse, f"on {case.name}: {len(worse)} parts are in more pieces than allowed")


@law("bisector", "refiner", "fixer", when=_is_thorough)
def time_grows_with_the_mesh(subject: Subject) -> None:
    """Four times as many cells take far less than sixteen times as long."""
    answer(subject, subject.build(), _case(subject.kind, (12, 10)))  # compile kernels off the clock
    sizes = (_LARGE, _LARGER) if subject.kind == "bisector" else (_SMALL, _LARGE)
    small, large = (_seconds(subject, _case(subject.kind, size)) for size in sizes)
    power = np.log(large / max(small, 1e-4)) / np.log(4.0)
    require(
        large < _NOTICEABLE or power < _STEEP,
        f"{np.prod(sizes[0]):,} cells took {small:.2f} s and {np.prod(sizes[1]):,} took {large:.2f} s, a "
        f"growth with the power {power:.1f} of the number of cells: compare no pairs of cells, visit only "
        "cells on the border of parts, and update values instead of recomputing them",
    )


def _case(kind: str, size: tuple[int, int]) -> Case:
    graph: Graph = small_meshes.grid(*size, jitter=0.2).graph
    name = f"{graph.n} cells"
    if kind == "bisector":
        return Case(name, (graph, seeds_for(1)))
    return labelled_case(kind, graph, name, clumps(graph, min(graph.n // 100, 80), strays=0.02), "both")


def _seconds(subject: Subject, case: Case) -> float:
    """Return the CPU time of a call: the minimum of three, because other load only increases it."""
    seconds = []
    for _ in range(3):
        tool, start = subject.build(), time.process_time()
        answer(subject, tool, case)
        seconds.append(time.process_time() - start)
        if seconds[-1] > 5.0:  # noise is much smaller
            break
    return min(seconds)
