"""The own cells of each rank as a piece of one grid of VTK: what all ranks must agree upon."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Int, fits_in_index, frozen_int
from agglo_core.distributed.distributed_mesh import DistributedMesh
from agglo_core.io.file_checks import naming
from agglo_core.io.grid_pieces import Share, piece_of
from agglo_core.io.listed_faces import usual_values
from agglo_core.io.pvtu_write import piece_name, pvtu_list
from agglo_core.io.tags import BRIDGES
from agglo_core.io.vtu_document import Piece, write_document
from agglo_core.io.vtu_write import face_stream

__all__ = ["write_pieces"]


def write_pieces(
    folder: Path,
    stem: str,
    mesh: DistributedMesh,
    tags: Mapping[str, Int],
    derived: Mapping[str, NDArray[Any]],
    *,
    compress: bool,
) -> None:
    """Write ``STEM.pvtu`` and in ``STEM/`` the own cells of each rank, with data of them ``(n_own,)``."""
    ranks = mesh.ranks
    share = Share(mesh.own, frozen_int(mesh.global_ids[mesh.own]), mesh.point_ids, _usual(mesh))
    with ranks.together():
        piece = piece_of(mesh.local, face_stream, tags, derived, share)
    piece = _agreed(piece, mesh)
    sources = [piece_name(stem, rank) for rank in range(ranks.size)]
    with ranks.together(), naming(Path(sources[ranks.rank])):
        (folder / stem).mkdir(exist_ok=True)
        write_document(folder / sources[ranks.rank], piece, compress=compress)
        if ranks.rank == 0:
            (folder / f"{stem}.pvtu").write_bytes(pvtu_list(piece, sources))


def _usual(mesh: DistributedMesh) -> dict[str, int]:
    """The value of face tags that is not written: the most common one of the first rank with cells."""
    with mesh.ranks.together():
        own = usual_values(mesh.local) if len(mesh.own) else None
    found = [usual for usual in mesh.ranks.gathered(own) if usual is not None]
    return found[0] if found else {}


def _agreed(piece: Piece, mesh: DistributedMesh) -> Piece:
    """With the same arrays of the same types as on all other ranks: VTK looks at the types of one piece."""
    data = {**piece.cell_data, **piece.derived}
    wide = {name for name, each in data.items() if each.dtype == np.int64 and not fits_in_index(each)}
    told = mesh.ranks.gathered((sorted(wide), BRIDGES in piece.cell_data))
    if any(bridged for _, bridged in told) and BRIDGES not in piece.cell_data:
        single = frozen_int(np.ones(len(mesh.own)))
        piece = piece._replace(cell_data={**piece.cell_data, BRIDGES: single})
    return piece._replace(wide=frozenset(name for names, _ in told for name in names))
