"""Tag value combinations that occur in a distributed mesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from agglo_core.arrays import Int, frozen_int
from agglo_core.distributed.agglomeration.part_components import first_cells
from agglo_core.distributed.communication import Ranks
from agglo_core.distributed.mesh.distributed_mesh import DistributedMesh
from agglo_core.mesh.tagging import BoundaryKinds, distinct

_MOST = 1_000
"""Maximum number of values per cell tag. Tags with more values on a rank, such as ids, are ignored.

Larger: more values to exchange.
"""


def kinds_of_all(mesh: DistributedMesh) -> tuple[Mapping[str, Int], BoundaryKinds]:
    """Return the tag combinations of all cells and boundary faces, equal on every rank. Collective.

    They are ``cell_kinds`` and ``boundary_kinds`` of the global mesh.
    """
    # Number the components of the domain by their first cell.
    ranks, local = mesh.ranks, mesh.local
    component = np.full(local.n_cells, -1)
    component[mesh.own] = first_cells(mesh)
    # Ignore tags with too many values on any rank.
    with ranks.together():
        few = [name for name, values in local.cell_tags.items() if len(np.unique(values[mesh.own])) <= _MOST]
    names = [name for name in local.cell_tags if all(name in values for values in ranks.gathered(few))]
    cells = _of_all(ranks, [local.cell_tags[name][mesh.own] for name in names])
    owner = local.face_cells[:, 0]
    outer = local.outer_faces & (mesh.owners == ranks.rank)[owner]
    components, *tags = _of_all(
        ranks, [frozen_int(component[owner[outer]]), *(values[outer] for values in local.face_tags.values())]
    )
    boundary = BoundaryKinds(components, dict(zip(local.face_tags, tags, strict=True)), whole=False)
    return dict(zip(names, cells, strict=True)), boundary


def _of_all(ranks: Ranks, columns: Sequence[Int]) -> list[Int]:
    """Return the distinct rows of all ranks' tables."""
    with ranks.together():
        own = distinct(columns)
    every = ranks.gathered(own)
    return distinct([frozen_int(np.concatenate(each)) for each in zip(*every, strict=True)])
