"""Laws for complete agglomeration runs, child processes and large meshes.

These laws are judged last, because failures of earlier laws are easier to read.
"""

from __future__ import annotations

import numpy as np

from agglo_core.agglomeration.border import broken_blocks
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.own_components import own_components
from agglo_core.conformance.base.running import runs_both_ways, runs_with
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import Broken, require
from agglo_core.conformance.inputs.cases import SIBLINGS
from agglo_core.conformance.inputs.drawn import drawn_labels
from agglo_core.conformance.inputs.questions import global_random, plain, same
from agglo_core.conformance.inputs.speed import seconds_for
from agglo_core.conformance.inputs.strategies import run_cases
from agglo_core.conformance.laws.bisector import bisects
from agglo_core.conformance.process.new_process import answers_elsewhere, can_be_sent, cases_elsewhere
from agglo_core.errors import AggloError, OptionError
from agglo_core.graph import functionals
from agglo_core.measure.agglomerates import quality

_LONGER = 1.25
"""Largest interface of grown parts relative to parts made depth by depth; small meshes vary a little."""


@law("bisector", "refiner", "fixer", "metric", draw=run_cases, examples=20)
def works_in_a_run(subject: Subject, case: Case) -> None:
    """Runs for a target count or size give connected parts as requested, and metrics can measure parts."""
    mesh, target = case.given
    try:
        if subject.kind == "metric":
            labels = drawn_labels(mesh.graph, "strips", 3)
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


@law("bisector", when=lambda subject: subject.has("grow") and bisects(subject))
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


@law(*SIBLINGS, "sample", when=can_be_sent)
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


_STEEP = 1.7  # exponent of the cell count; n log n is about 1.1, quadratic is 2
_NOTICEABLE = 0.5  # CPU seconds on the larger mesh; faster components always pass


@law("bisector", "refiner", "fixer", when=lambda subject: subject.thorough)
def time_grows_with_the_mesh(subject: Subject) -> None:
    """Four times as many cells take far less than sixteen times as long."""
    cells = 8000 if subject.kind == "bisector" else 2000
    seconds_for(subject, 100)  # compile kernels off the clock
    # Other load only increases the time of a call.
    small, large = (min(seconds_for(subject, n) for _ in range(3)) for n in (cells, 4 * cells))
    power = np.log(large / max(small, 1e-4)) / np.log(4.0)
    require(
        large < _NOTICEABLE or power < _STEEP,
        f"{cells:,} cells took {small:.2f} s and {4 * cells:,} took {large:.2f} s, a growth with the power "
        f"{power:.1f} of the number of cells: compare no pairs of cells, visit only cells on the border of "
        "parts, and update values instead of recomputing them",
    )
