"""Convert rule keywords to constraints, and compute the cell masses by which part counts are divided."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.agglomeration.choices import build_component
from agglo_core.agglomeration.keywords import BALANCES, BOUNDS, Keywords, Names
from agglo_core.arrays import Float, Int, frozen_float, plain_array
from agglo_core.errors import OptionError, PluginError
from agglo_core.graph import Graph
from agglo_core.graph.loads import Kind, Loads
from agglo_core.mesh import Mesh
from agglo_core.mesh.elsewhere import import_function
from agglo_core.mesh.marks import select_members, weights_of
from agglo_core.registry import Registry
from agglo_core.registry.attribution import Member, attributed

_TIE = 1e-4
"""Weight of the measure in masses, relative to the total mass. If two sides have equally many cells, the side
of larger measure counts as larger, independent of the axes (benchmarks/constants.py)."""


@dataclass(frozen=True)
class Rules(Keywords):
    """Rules for parts, such as regions and bounds, given by keywords or as components."""

    @property
    def bounds_weights(self) -> bool:
        """True if a bound on weights is set."""
        return self.max_weight is not None or self.min_weight is not None

    def check_rules(self) -> None:
        """Raise OptionError for values that are invalid on every mesh."""
        if isinstance(self.constraints, str) or not isinstance(self.constraints, Sequence):
            raise OptionError(f"constraints must be a sequence of components, given {self.constraints!r}")
        if self.boundary_rules not in (None, "ridges"):
            raise OptionError(f"boundary_rules must be 'ridges', given {self.boundary_rules!r}")
        if self.balance not in (None, *BALANCES):
            raise OptionError(f"balance must be one of {', '.join(BALANCES)}, given {self.balance!r}")
        if self.weights is not None and self.balance not in (None, "weights") and not self.bounds_weights:
            raise OptionError(
                f"weights have no effect with balance={self.balance!r}: pass balance='weights' "
                "or leave weights out"
            )
        self._bounds(self.weights)
        if not isinstance(self.lines, bool):
            raise OptionError(f"lines must be true or false, given {self.lines!r}")
        if self.lines and any(getattr(self, name) is not None for name in BOUNDS if name[:3] == "max"):
            raise OptionError(
                "lines=True cannot be combined with max_cells, max_measure or max_weight: a "
                "line may exceed the bound"
            )

    def members(self, mesh: Mesh | Graph, graph: Graph, registry: Registry) -> list[Member]:
        """Return all constraints on this mesh: first those from keywords, then those given as components."""
        result = [Member(tool, f"constraint {name!r}") for name, tool in self._by_keyword(mesh, graph)]
        for choice in self.constraints:
            result.append(_on_mesh(build_component("constraint", choice, registry)[0], mesh))
        return result

    def balanced(
        self,
        graph: Graph,
        *,
        counts: bool,
        total: Callable[[Float], float] = lambda values: float(values.sum()),
    ) -> Graph:
        """Return the graph with the cell loads by which part counts are divided.

        Size goals do not use loads. The callable ``total`` sums values over all cells, including cells on
        other processes.

        Raises
        ------
        OptionError
            If the target is a size, and weights or a balance are given.
        """
        # 1. Size goals accept neither weights nor a balance.
        if not counts:
            if self.weights is not None and not self.bounds_weights:
                raise OptionError(
                    "weights applies to counts (n_parts, cells_per_part), not to sizes (h_star, h_factor)"
                )
            if self.balance is not None:
                raise OptionError(
                    "balance applies to counts (n_parts, cells_per_part), not to sizes (h_star, h_factor)"
                )
            return graph
        # 2. Balance by measure.
        if self.balance == "measure":
            return graph.with_loads(Loads("measure"))
        # 3. Balance by cells or weights, with a small share of the measure to break ties.
        loads = mass = self.mass(graph)
        whole, heavy = total(graph.measures), total(mass)
        if whole > 0:
            share = graph.measures * (_TIE * heavy / whole)
            share += mass
            mass = frozen_float(share)
        kind: Kind = "cells" if self.weights is None and self.balance != "weights" else "weights"
        return graph.with_loads(Loads(kind, mass, weights=loads if kind == "weights" else None))

    def mass(self, graph: Graph) -> Float:
        """Return the cell masses ``(n,)`` by which part counts are divided."""
        weights = self.cell_weights(graph)
        if self.balance == "weights" or (self.balance is None and weights is not None):
            return graph.weights if weights is None else weights
        return graph.measures if self.balance == "measure" else np.broadcast_to(1.0, graph.n)

    def cell_weights(self, graph: Graph) -> Float | None:
        """Return the cell ``weights (n,)``, or None if not given."""
        return None if self.weights is None else weights_of(self.weights, graph.data, graph.n)

    def _by_keyword(self, mesh: Mesh | Graph, graph: Graph) -> list[tuple[str, Any]]:
        rules: list[tuple[str, Any]] = []
        if self.regions is not None:
            rules.append(("regions", _regions(self.regions)))
        if self.barriers is not None:
            tags = _component("barriers:BarrierTags")(self.barriers)
            rules.append(("barriers", tags.for_mesh(_faces(mesh, "barriers"))))
        if self.where is not None:
            alone = ~select_members("where", self.where, graph.data, graph.n, "cell")
            rules.append(("where", _component("regions:SingleCells")(alone)))
        if self.boundary_rules is not None:
            rules.append(
                ("boundary_rules", _component("ridges:Ridges")().for_mesh(_faces(mesh, "boundary_rules")))
            )
        bounds = [name for name in BOUNDS if getattr(self, name) is not None]
        if bounds:
            rules.append((" and ".join(bounds), self._bounds(self.cell_weights(graph))))
        return rules

    def _bounds(self, weights: Any) -> Any:
        limits = {name: getattr(self, name) for name in BOUNDS}
        return _component("bounds:Bounds")(**limits, weights=weights)


def imbalance(mass: Float | None, labels: Int) -> float:
    """Return the largest part mass (cell count) over the mean, or 1 if the total mass is zero."""
    of_parts = np.bincount(labels, mass)
    mean = float(of_parts.mean())
    return float(of_parts.max()) / mean if mean > 0 else 1.0


def _component(name: str) -> Callable[..., Any]:
    return import_function(f"agglo_core.constraints.{name}")


def _regions(regions: Names | ArrayLike) -> Any:
    make = _component("regions:Regions")
    if isinstance(regions, str) or (
        isinstance(regions, Sequence) and all(isinstance(e, str) for e in regions)
    ):
        return make(regions if isinstance(regions, str) else tuple(regions))
    values = plain_array(regions, "regions", OptionError)
    if values.dtype.kind not in "iubU":
        raise OptionError(f"regions must be names of cell tags, integers or booleans, given {values.dtype}")
    return make(values=values)


def _faces(mesh: Mesh | Graph, word: str) -> Mesh:
    if not isinstance(mesh, Mesh):
        raise OptionError(f"{word} needs a mesh: a graph has no faces")
    return mesh


def _on_mesh(member: Member, mesh: Mesh | Graph) -> Member:
    """Adapt a constraint to the mesh if it has the method ``for_mesh``."""
    if not callable(getattr(member.tool, "for_mesh", None)):
        return member
    if not isinstance(mesh, Mesh):
        raise OptionError(f"{member.title} needs a mesh: a graph has no faces")
    with attributed(member.title):
        tool = member.tool.for_mesh(mesh)
    if not any(callable(getattr(tool, name, None)) for name in ("forbidden", "admissible", "incomplete")):
        raise PluginError(f"{member.title}: for_mesh returned {tool!r:.60}, expected a constraint")
    return Member(tool, member.title)
