"""Protocols: the methods and attributes that components of each kind must have.

Nothing is inherited: a class with the method is a component.

Which kinds there are, and what is checked when they are built: :mod:`agglo_core.registry.kinds`.

A *part* is a (block, label) pair: labels are local to their block. A *level* is a block-diagonal
:class:`~agglo_core.graph.Graph` whose blocks are the pieces of one recursion depth. The law every
component obeys: **a level is its blocks** — what happens to one block never depends on the others.
"""

from __future__ import annotations

from agglo_core.protocols.on_constraints import Admitting, Completing, Constraint, Forbidding
from agglo_core.protocols.on_files import Format, HierarchyFormat, WritableFormat
from agglo_core.protocols.on_graphs import (
    Bisector,
    ConnectivityFixer,
    LevelBisector,
    Partitioner,
    Refiner,
    Sides,
    Target,
    TargetAware,
    UnevenBisector,
)
from agglo_core.protocols.on_problems import ProblemKind, Smoother, Solver
from agglo_core.protocols.on_quality import IncrementalMetric, QualityMetric, Section

__all__ = [
    "Admitting",
    "Bisector",
    "Completing",
    "ConnectivityFixer",
    "Constraint",
    "Forbidding",
    "Format",
    "HierarchyFormat",
    "IncrementalMetric",
    "LevelBisector",
    "Partitioner",
    "ProblemKind",
    "QualityMetric",
    "Refiner",
    "Section",
    "Sides",
    "Smoother",
    "Solver",
    "Target",
    "TargetAware",
    "UnevenBisector",
    "WritableFormat",
]
