"""Complete agglomeration runs with the component under test, for target counts and target sizes.

A registered component is passed by name, as users do.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from agglo_core import builtin
from agglo_core.agglomeration.border import bisect_by_block
from agglo_core.arrays import UInt64
from agglo_core.conformance.base.own_components import own_components
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.inputs.drawn import DrawnMesh
from agglo_core.errors import AggloError
from agglo_core.graph import Graph
from agglo_core.hierarchy import Hierarchy
from agglo_core.mesh import Mesh
from agglo_core.registry import Component, Record, Registry, hookimpl


def runs_with(subject: Subject, mesh: Mesh, target: Mapping[str, Any]) -> Iterator[tuple[str, Hierarchy]]:
    """Agglomerate a mesh with the component in each of its roles, and yield description and hierarchy.

    Exceptions of the run propagate.
    """
    from agglo_core.agglomeration.one_call import agglomerate

    choice, registry = _choose_component(subject)
    for roles in _roles(subject, choice):
        (kind, value), *_ = target.items()
        description = f"on {mesh.name}, {roles['method']}, {kind}={value}"
        yield description, agglomerate(mesh, **roles, **target, registry=registry)


def runs_both_ways(subject: Subject) -> Iterator[tuple[str, Hierarchy, Hierarchy]]:
    """Yield two hierarchies of each run: with the bisector's ``grow`` method, and without it.

    ``grow`` performs all splits of a level in one call. Without it, the bisector is called once for each
    depth of the recursion. A description precedes the hierarchies.
    """
    from agglo_core.agglomeration.one_call import agglomerate

    registry = own_components()
    for mesh in _meshes(subject):
        for refiners in ([], [registry.build("refiner", "interface")]):
            grow_hierarchy, split_hierarchy = (
                agglomerate(
                    mesh,
                    bisector=bisector,
                    refiners=refiners,
                    polish=False,
                    n_parts=(9, 4),
                    registry=registry,
                )
                for bisector in (subject.build(), _DepthByDepth(subject.build()))
            )
            yield f"on {mesh.name}, {len(refiners)} refiners", grow_hierarchy, split_hierarchy


@dataclass(frozen=True)
class _DepthByDepth:
    """Wrapper that hides the optional methods of a bisector, such as ``grow``."""

    tool: Any

    def bisect_level(self, level: Graph, seeds: UInt64) -> Any:
        """Return the side per node ``(n,)``, computed by the wrapped bisector."""
        if callable(getattr(self.tool, "bisect_level", None)):
            return self.tool.bisect_level(level, seeds)
        return bisect_by_block(self.tool, level, seeds)


def _meshes(subject: Subject) -> list[Mesh]:
    recipes = [DrawnMesh(cells=63, jitter=0.25), DrawnMesh("comb"), DrawnMesh("boxes", cells=30)]
    return [recipe.mesh for recipe in recipes if recipe.dim == 2 or subject.promised("3d")]


def _roles(subject: Subject, choice: Any) -> list[dict[str, Any]]:
    """Return the keyword arguments of ``agglomerate`` for each run with the component under test.

    A bisector is run with all its methods, a refiner as both ``refiners`` and ``post_refiners``.
    """
    registry = own_components()
    defaults = {
        "bisector": registry.build("bisector", "inertial"),
        "fixer": registry.build("fixer", "connectivity"),
        "post_refiners": [registry.build("refiner", "compactness")],
    }
    recursive = defaults | {"refiners": [registry.build("refiner", "interface")], "method": "recursive"}
    if subject.kind == "bisector":
        bisects = subject.has("bisect") or subject.has("bisect_level")
        methods = ["recursive"] * bisects + ["kway"] * subject.partitions
        return [recursive | {"bisector": choice, "method": method} for method in methods]
    if subject.kind == "refiner":
        return [recursive | {"refiners": [choice], "post_refiners": [choice]}]
    return [recursive | {"refiners": [], "fixer": choice}]


@dataclass(frozen=True)
class _Declares:
    """Plugin that declares the given components."""

    components: Sequence[Component]

    @hookimpl
    def agglo_components(self) -> Sequence[Component]:
        return list(self.components)


def _choose_component(subject: Subject) -> tuple[Any, Registry]:
    """Return the component as an argument of ``agglomerate``, and a registry that contains it."""
    record = subject.record
    if record is None or record.component is None:
        return subject.build(), own_components()
    name = f"{record.distribution or record.plugin}/{record.name}"
    choice = (name, subject.options) if subject.options else name
    return choice, subject.lookup if _is_registered(record, name, subject.lookup) else _registry_with(record)


def _is_registered(record: Record, name: str, registry: Registry) -> bool:
    try:
        return registry.record(record.kind, name).component is record.component
    except AggloError:
        return False


def _registry_with(record: Record) -> Registry:
    """Return a registry with the built-in components and one more declared component."""
    registry = Registry()
    registry.register(builtin, "defaults", distribution="agglo")
    declared = [] if record.component is None else [record.component]
    registry.register(_Declares(declared), record.plugin, distribution=record.distribution)
    return registry
