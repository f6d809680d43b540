"""The laws of whole runs, asked last: what else is wrong is easier to see."""

from __future__ import annotations

from agglo_core.agglomeration.border import broken_blocks
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.own_components import own_components
from agglo_core.conformance.base.running import runs_both_ways, runs_with
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import Broken, require
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.cases import stripes
from agglo_core.errors import AggloError
from agglo_core.graph import functionals
from agglo_core.measure.agglomerates import quality

_LONGER = 1.25
"""Interface of parts that are grown over that of the usual ones: on meshes this small it varies a little."""


@law("bisector", "refiner", "fixer", "metric")
def works_in_a_run(subject: Subject) -> None:
    """Runs with it, by count and by size, give connected parts as asked for; a metric measures those."""
    try:
        if subject.kind == "metric":
            mesh = small_meshes.grid(9, 7, jitter=0.2)
            quality(mesh, stripes(mesh.graph, 3), metrics=[subject.build()], registry=own_components())
            return
        for asked, hierarchy in runs_with(subject):
            for target, parts in zip(hierarchy.targets, hierarchy.parts, strict=True):
                require(target.get("n_parts", parts) == parts, f"a run {asked} gave {parts} parts")
            for labels in hierarchy.levels:
                loose = broken_blocks(hierarchy.graph, labels)
                require(not len(loose), f"a run {asked} gave parts in pieces")
    except AggloError as error:
        raise Broken(f"a run with it failed: {error}") from error


def _grows(subject: Subject) -> bool:
    return subject.has("grow") and (subject.has("bisect") or subject.has("bisect_level"))


@law("bisector", when=_grows)
def grows_alike(subject: Subject) -> None:
    """The parts that a bisector grows are as good as those that its own splits make depth by depth."""
    try:
        for asked, one, other in runs_both_ways(subject):
            for labels, usual in zip(one.levels, other.levels, strict=True):
                cut, wanted = (
                    functionals.cut(one.graph, each, edge_weights=one.graph.interface)
                    for each in (labels, usual)
                )
                require(
                    cut <= _LONGER * wanted,
                    f"{asked}: the interface of the parts that grow made is {cut:.4g} long, of those "
                    f"made depth by depth {wanted:.4g}: cut alike, and decline components that are not known",
                )
    except AggloError as error:
        raise Broken(f"a run with it failed: {error}") from error
