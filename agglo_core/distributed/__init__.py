"""Meshes and hierarchies distributed across MPI processes (ranks)."""

from __future__ import annotations

from agglo_core.distributed.agglomeration.hierarchy import DistributedHierarchy
from agglo_core.distributed.agglomeration.run import agglomerate
from agglo_core.distributed.communication import RankError, Ranks, Traffic
from agglo_core.distributed.files.reading import read
from agglo_core.distributed.files.writing import write
from agglo_core.distributed.mesh.distributed_mesh import DistributedMesh
from agglo_core.distributed.solution.errors import error_norms
from agglo_core.distributed.solution.pieces import write_solution
from agglo_core.distributed.solution.second_layer import with_second_layer

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
