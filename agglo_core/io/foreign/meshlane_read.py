"""Every other format through meshlane, behind one adapter that turns all its failures into FileError."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Unpack

import numpy as np

from agglo_core.arrays import frozen_float, frozen_int, trusted_copy
from agglo_core.errors import AggloError, FileError
from agglo_core.files.regular import text_bytes, without_mark
from agglo_core.io.foreign.unread import why_unread
from agglo_core.io.format_options import ReadOptions
from agglo_core.io.gmsh.read import soup_of_gmsh
from agglo_core.io.tags import note_left_out
from agglo_core.io.to_mesh.soup import Soup, mesh_from_soup
from agglo_core.io.vtk.legacy import legacy_kind, stored_legacy
from agglo_core.io.vtk.pieces import mesh_from_pieces
from agglo_core.mesh import Mesh
from agglo_core.mesh.elements import Polyhedra

_log = logging.getLogger("agglo")
_SECONDS, _BYTES_PER_SECOND = 6, 100_000  # processor time allowed: far above what a whole file needs
_MEMORY, _MEMORY_PER_BYTE = 1 << 28, 400  # beyond what the program itself takes


def read_foreign(path: Path, **options: Unpack[ReadOptions]) -> Mesh:
    """Mesh of any file that meshlane reads; integer cell data and cell sets become tags.

    Raises
    ------
    FileError, MeshError
        For a broken file or mesh; FileError for a layout that is known and not read.
    """
    try:
        return _read(path, options)
    except AggloError as error:
        known = why_unread(path)
        if known is None:
            raise
        raise FileError(known) from error


def _read(path: Path, options: ReadOptions) -> Mesh:
    if legacy_kind(path):
        return mesh_from_pieces(stored_legacy(path), **options, name=path.stem)
    soup, sets, left = soup_of_gmsh(text_bytes(path)) if _is_gmsh(path) else _soup(path)
    mesh = mesh_from_soup(soup, weak=False, name=path.stem, **options)
    mesh = _without_empty_sets(mesh, sets)
    _note_sets(mesh, sets)
    return note_left_out(mesh, left)


def _is_gmsh(path: Path) -> bool:
    with open(path, "rb") as file:
        return without_mark(file.read(64)).lstrip().startswith((b"$MeshFormat", b"$Comments"))


def _soup(path: Path) -> tuple[Soup, set[str], list[str]]:
    """Cells that meshlane finds, in a separate process; names of tags that are sets, and of data left out."""
    size = path.stat().st_size
    seconds, memory = _SECONDS + size // _BYTES_PER_SECOND, _MEMORY + _MEMORY_PER_BYTE * size
    with tempfile.TemporaryDirectory(prefix="agglo-") as folder:
        target = os.path.join(folder, "cells.npz")
        command = [sys.executable, "-P", "-m", "agglo_core.io.foreign.meshlane_soup"]
        search = os.pathsep.join(part for part in sys.path if part)
        try:
            done = subprocess.run(
                [*command, str(_without_marks(path.absolute(), folder)), target, str(seconds), str(memory)],
                env={**os.environ, "PYTHONPATH": search, "OPENBLAS_NUM_THREADS": "1"},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                timeout=20 * seconds,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise FileError(f"meshlane did not read it within {20 * seconds} s") from None
        if done.returncode < 0:
            raise FileError(
                f"meshlane did not read it within {seconds} s of processor time, or crashed "
                f"(signal {-done.returncode}): the file is probably truncated"
            )
        if done.returncode:
            reason = done.stdout.decode(errors="replace").strip()
            raise FileError(f"meshlane cannot read it: {reason[:300] or 'no reason given'}")
        return _load(target)


def _without_marks(path: Path, folder: str) -> Path:
    """Return the path, or that of a copy in a folder if the file begins with a byte order mark.

    Parsers of XML pass over the mark. TetGen's pair of files is copied together.
    """
    with open(path, "rb") as file:
        head = file.read(64)
    if without_mark(head) == head or without_mark(head).lstrip().startswith(b"<"):
        return path
    pair = (".ele", ".node") if path.suffix.lower() in (".ele", ".node") else (path.suffix,)
    for suffix in pair:
        copy = Path(folder, path.name).with_suffix(suffix)
        copy.write_bytes(text_bytes(path.with_suffix(suffix)))
    return copy.with_suffix(path.suffix)


def _load(target: str) -> tuple[Soup, set[str], list[str]]:
    with np.load(target, allow_pickle=False) as arrays:
        names = json.loads(arrays["names"].tobytes())
        solids = (frozen_int(arrays[key]) for key in ("cell_offsets", "loop_offsets", "loops"))
        soup = Soup(
            frozen_float(arrays["points"]),
            frozen_int(arrays["types"]),
            frozen_int(arrays["offsets"]),
            frozen_int(arrays["vertices"]),
            Polyhedra(*solids),
            {name: frozen_int(arrays[f"tag_{i}"]) for i, name in enumerate(names["tags"])},
        )
        return soup, set(names["sets"]), names["left"]


def _note_sets(mesh: Mesh, sets: set[str]) -> None:
    """Log the named parts of the mesh and of its boundary, which can be chosen by name."""
    for what, tags in (("cells", mesh.cell_tags), ("faces", mesh.face_tags)):
        found = [f"{name} ({(values == 1).sum():,})" for name, values in tags.items() if name in sets]
        if found:
            _log.info("%s by name: %s", what, ", ".join(found))


def _without_empty_sets(mesh: Mesh, names: set[str]) -> Mesh:
    """Mesh without tags of sets that hold no cell or no face, and without face tags of −1 alone.

    A set lives in one dimension, so that most are empty in the other. Those empty in both are warned about.
    """
    cell_tags, face_tags = (
        {name: values for name, values in tags.items() if name not in names or (values == 1).any()}
        for tags in (mesh.cell_tags, mesh.face_tags)
    )
    face_tags = {name: values for name, values in face_tags.items() if (values != -1).any()}
    lost = sorted(names - cell_tags.keys() - face_tags.keys())
    if lost:
        _log.warning("groups without a cell or face of the mesh left out: %s", ", ".join(lost))
    return trusted_copy(mesh, cell_tags=cell_tags, face_tags=face_tags)
