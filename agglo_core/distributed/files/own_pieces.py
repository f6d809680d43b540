"""Writer for VTK files with one file (piece) per rank, and removal of outdated ones."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Int, fits_in_index, frozen_int
from agglo_core.distributed.communication import Ranks
from agglo_core.distributed.mesh.distributed_mesh import DistributedMesh
from agglo_core.io.file_checks import name_in_errors
from agglo_core.io.tags import BRIDGES
from agglo_core.io.to_mesh.listed_faces import usual_values
from agglo_core.io.vtk.grids import Share, piece_of
from agglo_core.io.vtk.pvtu import piece_name, pvtu_list
from agglo_core.io.vtk.vtu import face_stream, is_own_file
from agglo_core.io.vtk.xml_write import Piece, write_document


def write_pieces(
    folder: Path,
    stem: str,
    mesh: DistributedMesh,
    tags: Mapping[str, Int],
    derived: Mapping[str, NDArray[Any]],
    *,
    compress: bool,
) -> None:
    """Write ``STEM.pvtu``, and each rank's cells with data ``(n_own,)`` to ``STEM/``."""
    ranks = mesh.ranks
    share = Share(mesh.own, frozen_int(mesh.global_ids[mesh.own]), mesh.point_ids, _usual_tags(mesh))
    with ranks.together():
        piece = piece_of(mesh.local, face_stream, tags, derived, share)
    write_agreed(folder, stem, _with_loops(piece, mesh), ranks, compress=compress)


def write_agreed(folder: Path, stem: str, piece: Piece, ranks: Ranks, *, compress: bool = False) -> None:
    """Write ``STEM.pvtu``, and each rank's VTK piece to ``STEM/``. Array names are equal on all ranks.

    Array types are made equal, too, because VTK reads types from a single piece.
    """
    data = {**piece.cell_data, **piece.derived}
    wide = {name for name, each in data.items() if each.dtype == np.int64 and not fits_in_index(each)}
    piece = piece._replace(wide=frozenset().union(*ranks.gathered(sorted(wide))))
    sources = [piece_name(stem, rank) for rank in range(ranks.size)]
    with ranks.together(), name_in_errors(Path(sources[ranks.rank])):
        (folder / stem).mkdir(exist_ok=True)
        write_document(folder / sources[ranks.rank], piece, compress=compress)
        if ranks.rank == 0:
            (folder / f"{stem}.pvtu").write_bytes(pvtu_list(piece, sources))


def _usual_tags(mesh: DistributedMesh) -> dict[str, int]:
    """Return the omitted value per face tag: the most common on the first rank with cells."""
    with mesh.ranks.together():
        own = usual_values(mesh.local) if len(mesh.own) else None
    found = [usual for usual in mesh.ranks.gathered(own) if usual is not None]
    return found[0] if found else {}


def _with_loops(piece: Piece, mesh: DistributedMesh) -> Piece:
    """Add the array of boundary loops per cell if the piece of another rank has this array."""
    present = mesh.ranks.gathered(BRIDGES in piece.cell_data)
    if BRIDGES in piece.cell_data or not any(present):
        return piece
    single = frozen_int(np.ones(len(mesh.own)))
    return piece._replace(cell_data={**piece.cell_data, BRIDGES: single})


def remove_pieces(folder: Path, size: int) -> None:
    """Remove the VTK pieces of ranks ≥ ``size``, left by an earlier run. May raise OSError."""
    pattern = re.compile(re.escape(folder.name) + r"_(0|[1-9]\d*)\.vtu", re.ASCII)
    for file in sorted(folder.iterdir()) if folder.is_dir() else ():
        found = pattern.fullmatch(file.name)
        if not found or int(found[1]) < size or file.is_symlink():
            continue
        if is_own_file(file, solutions=True):
            file.unlink()
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()
