"""Protocols: methods and attributes of each component kind.

Components need no base class: any class with the methods is a component. :mod:`agglo_core.registry.kinds`
lists the kinds, and the checks at construction.

A *part* is a (block, label) pair, with labels local to their block. A *level* is a block-diagonal
:class:`~agglo_core.graph.Graph` whose blocks are the pieces of one recursion depth. All components obey one
law: **a level is its blocks**, so the result for a block never depends on other blocks.
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
from agglo_core.protocols.on_problems import Estimator, ProblemKind, Smoother, Solver
from agglo_core.protocols.on_quality import IncrementalMetric, QualityMetric, Section

__all__ = [
    "Admitting",
    "Bisector",
    "Completing",
    "ConnectivityFixer",
    "Constraint",
    "Estimator",
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
