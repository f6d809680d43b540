"""Laws for complete agglomeration runs, child processes and large meshes.

These laws are judged last, because failures of earlier laws are easier to read.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np

from agglo_core.agglomeration.border import bisect_by_block, broken_blocks
from agglo_core.agglomeration.one_call import agglomerate
from agglo_core.arrays import UInt64
from agglo_core.conformance.base import Broken, Case, Subject, law, require
from agglo_core.conformance.base.own_components import own_components
from agglo_core.conformance.inputs.cases import SIBLINGS
from agglo_core.conformance.inputs.drawn import DrawnMesh, drawn_labels
from agglo_core.conformance.inputs.questions import global_random, plain, same
from agglo_core.conformance.inputs.speed import seconds_for
from agglo_core.conformance.inputs.strategies import run_cases
from agglo_core.conformance.laws.bisector import bisects
from agglo_core.conformance.process.new_process import answers_elsewhere, can_be_sent, cases_elsewhere
from agglo_core.errors import AggloError, OptionError
from agglo_core.graph import Graph, functionals
from agglo_core.hierarchy import Hierarchy
from agglo_core.measure.agglomerates import quality
from agglo_core.mesh import Mesh
from agglo_core.registry import Component, Registry, hookimpl

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
        choice, registry = _choice(subject)
        for roles in _roles(subject, choice):
            hierarchy = agglomerate(mesh, **roles, **target, registry=registry)
            run = f"on {case.name}: a run, {roles['method']}, for {target}"
            for reached, parts in zip(hierarchy.targets, hierarchy.parts, strict=True):
                require(reached.get("n_parts", parts) == parts, f"{run} gave {parts} parts")
            for labels in hierarchy.levels:
                require(not len(broken_blocks(hierarchy.graph, labels)), f"{run} gave parts in pieces")
    except AggloError as error:
        if isinstance(error, OptionError) and "h_factor" in target and subject.has("for_target"):
            return  # for_target may refuse a size
        raise Broken(f"on {case.name} with {target}: a run with it failed: {error}") from error


def _roles(subject: Subject, choice: Any) -> list[dict[str, Any]]:
    """Return the keyword arguments of ``agglomerate`` for each run with the component under test.

    A bisector is run with all its methods, a refiner as both ``refiners`` and ``post_refiners``.
    """
    registry = own_components()
    usual = {
        "method": "recursive",
        "bisector": registry.build("bisector", "inertial"),
        "refiners": [registry.build("refiner", "interface")],
        "fixer": registry.build("fixer", "connectivity"),
        "post_refiners": [registry.build("refiner", "compactness")],
    }
    if subject.kind == "bisector":
        methods = ["recursive"] * bisects(subject) + ["kway"] * subject.partitions
        return [usual | {"bisector": choice, "method": method} for method in methods]
    if subject.kind == "refiner":
        return [usual | {"refiners": [choice], "post_refiners": [choice]}]
    return [usual | {"refiners": [], "fixer": choice}]


@dataclass(frozen=True)
class _Declares:
    """Plugin that declares one component."""

    component: Component

    @hookimpl
    def agglo_components(self) -> Sequence[Component]:
        return [self.component]


def _choice(subject: Subject) -> tuple[Any, Registry]:
    """Return the component as an argument of ``agglomerate``, and a registry that contains it.

    A declared component is chosen by name, as users do.
    """
    record = subject.record
    if record is None or record.component is None:
        return subject.build(), own_components()
    name, registry = f"{record.distribution or record.plugin}/{record.name}", subject.lookup
    choice = (name, subject.options) if subject.options else name
    with suppress(AggloError):
        if registry.record(record.kind, name).component is record.component:
            return choice, registry
    registry = own_components.__wrapped__()
    registry.register(_Declares(record.component), record.plugin, distribution=record.distribution)
    return choice, registry


@law("bisector", when=lambda subject: subject.has("grow") and bisects(subject))
def grows_alike(subject: Subject) -> None:
    """Parts made by ``grow`` are as good as parts made by the bisector's own splits depth by depth."""
    recipes = [DrawnMesh(cells=63, jitter=0.25), DrawnMesh("comb"), DrawnMesh("boxes", cells=30)]
    for mesh in (recipe.mesh for recipe in recipes if recipe.dim == 2 or subject.promised("3d")):
        for refiners in ([], ["interface"]):
            # ``grow`` makes all splits of a level in one call; without it, there is a call for each depth.
            tool = subject.build()
            alone = SimpleNamespace(bisect_level=partial(_split, tool))
            try:
                grown, usual = (_grow(each, mesh, refiners) for each in (tool, alone))
            except AggloError as error:
                raise Broken(f"a run with it failed: {error}") from error
            for labels, usual_labels in zip(grown.levels, usual.levels, strict=True):
                cut, usual_cut = (
                    functionals.cut(mesh.graph, parts, edge_weights=mesh.graph.interface)
                    for parts in (labels, usual_labels)
                )
                require(
                    cut <= _LONGER * usual_cut,
                    f"on {mesh.name}, {len(refiners)} refiners: parts made by grow have an interface of "
                    f"{cut:.4g}, those made depth by depth of {usual_cut:.4g}: use the same splits in both, "
                    "and decline unknown components",
                )


def _split(tool: Any, level: Graph, seeds: UInt64) -> Any:
    """Return the side per node ``(n,)`` by the bisector's own splits."""
    if callable(getattr(tool, "bisect_level", None)):
        return tool.bisect_level(level, seeds)
    return bisect_by_block(tool, level, seeds)


def _grow(bisector: Any, mesh: Mesh, refiners: list[str]) -> Hierarchy:
    options = {"bisector": bisector, "refiners": refiners, "polish": False, "n_parts": (9, 4)}
    return agglomerate(mesh, **options, registry=own_components())


@law(*SIBLINGS, "sample", when=can_be_sent)
def same_in_another_process(subject: Subject) -> None:
    """Another process with other hash values, threads and current folder gives equal results."""
    test_cases, tool = cases_elsewhere(subject), subject.build()
    with global_random(1):
        expected = [plain(subject, case, tool) for case in test_cases]
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
