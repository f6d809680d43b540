"""Meshes and hierarchies whose cells lie on several processes (ranks) of MPI."""

from __future__ import annotations

from agglo_core.distributed.agglomerating import agglomerate
from agglo_core.distributed.communication import RankError, Ranks, Traffic
from agglo_core.distributed.distributed_hierarchy import DistributedHierarchy
from agglo_core.distributed.distributed_mesh import DistributedMesh
from agglo_core.distributed.reading import read
from agglo_core.distributed.second_layer import with_second_layer
from agglo_core.distributed.solution_errors import error_norms
from agglo_core.distributed.solution_pieces import write_solution
from agglo_core.distributed.writing import write

__all__ = [
    "DistributedHierarchy",
    "DistributedMesh",
    "RankError",
    "Ranks",
    "Traffic",
    "agglomerate",
    "error_norms",
    "read",
    "with_second_layer",
    "write",
    "write_solution",
]
