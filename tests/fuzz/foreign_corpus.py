"""Small valid files in formats read through meshlane, and a faster way to read them."""

from __future__ import annotations

import importlib.util
import io
import os
import select
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import meshlane
import numpy as np
from fuzz.several import SEVERAL, packed

from agglo_core import read, samples
from agglo_core.io.foreign import meshlane as meshlane_files, meshlane_soup

__all__ = ["FOREIGN", "foreign_files", "without_new_processes"]

_TEXT = (".avs", ".bdf", ".cdb", ".dat", ".f3grid", ".inp", ".mdpa", ".mesh", ".post", ".su2", ".vol", ".wkt")
_BINARY = (".meshb", ".stl", ".ugrid", ".xdmf", ".xml")
_NEEDED = {"h5py": (".cgns", ".h5m", ".hmf", ".med"), "netCDF4": (".exo",)}
_PACKAGES = [package for package in _NEEDED if importlib.util.find_spec(package)]
FOREIGN = (*_TEXT, *_BINARY, *(suffix for package in _PACKAGES for suffix in _NEEDED[package]))
"""One suffix per meshlane reader available here."""

_GRID = """# vtk DataFile Version 3.0
a grid
ASCII
DATASET STRUCTURED_GRID
DIMENSIONS 3 2 1
POINTS 6 float
0 0 0 1 0 0 2 0 0 0 1 0 1 1 0 2 1 0
CELL_DATA 2
SCALARS mat int 1
LOOKUP_TABLE default
4 5
"""


@cache
def foreign_files(suffix: str) -> list[bytes]:
    """Return small valid files of a suffix, also if agglo has a reader for it."""
    if suffix == ".vtk":
        return [_GRID.encode()]
    return list(_written(suffix)) if suffix in (*FOREIGN, ".msh") else []


def _written(suffix: str) -> Iterator[bytes]:
    """Yield the meshes that meshlane can write and read back."""
    for mesh in _meshes():
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / f"m{suffix}"
            try:
                with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
                    meshlane.write(file, mesh)
                with without_new_processes():
                    read(file)
            except (Exception, SystemExit):  # meshlane raises any exception for unsupported meshes
                continue
            files = {path.name: path.read_bytes() for path in Path(folder).iterdir()}
            if suffix in SEVERAL or len(files) == 1:
                yield packed(files) if suffix in SEVERAL else files[file.name]


def _meshes() -> Iterator[meshlane.Mesh]:
    """Yield triangles, mixed cells with numbers, tetrahedra with a boundary face, and a hexahedron."""
    triangles = samples.triangles(2)
    loops = triangles.boundary_loops.vertices.reshape(-1, 3)
    flat = np.c_[triangles.points, np.zeros(triangles.n_points)]
    two = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0.0]])
    mixed = [("quad", np.array([[0, 1, 2, 3]])), ("triangle", np.array([[1, 4, 2]]))]
    mixed.append(("line", np.array([[0, 1]])))
    corner = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], float)
    tetrahedra = np.array([[0, 1, 2, 3], [1, 2, 3, 4]])
    cube = np.array(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], float
    )
    yield meshlane.Mesh(flat, [("triangle", loops)])
    yield meshlane.Mesh(triangles.points, [("triangle", loops)])
    yield meshlane.Mesh(two, mixed, cell_data={"mat": [np.array([1]), np.array([2]), np.array([3])]})
    yield meshlane.Mesh(two, mixed)
    yield meshlane.Mesh(corner, [("tetra", tetrahedra)])
    yield meshlane.Mesh(corner, [("tetra", tetrahedra), ("triangle", tetrahedra[:1, :3])])
    yield meshlane.Mesh(cube, [("hexahedron", np.arange(8)[None])])


@contextmanager
def without_new_processes() -> Iterator[None]:
    """Read in forks of this process instead of new processes, with equal limits.

    A new process would take half a second to import its modules.
    """
    several = {name: getattr(subprocess, name) for name in ("DEVNULL", "PIPE", "TimeoutExpired")}
    with mock.patch.object(meshlane_files, "subprocess", SimpleNamespace(run=_run_copy, **several)):
        yield


def _run_copy(command: list[str], *, timeout: float, **_: object) -> subprocess.CompletedProcess[bytes]:
    """Run the program ``meshlane_soup`` in a fork of this process."""
    source, target, seconds, memory = command[-4:]
    receiving, sending = os.pipe()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            os.close(receiving)
            os.dup2(sending, 1)
            with open(1, "w", closefd=False) as said_by_child, redirect_stdout(said_by_child):
                code = meshlane_soup.main(source, target, int(seconds), int(memory))
        finally:
            os._exit(code)
    # Collect the output until the fork ends or the timeout is reached.
    os.close(sending)
    said, end = b"", time.monotonic() + timeout
    with open(receiving, "rb", buffering=0) as stream:
        while select.select([stream], [], [], max(0.0, end - time.monotonic()))[0]:
            piece = stream.read(1 << 16)
            if not piece:
                break
            said += piece
        else:
            os.kill(child, signal.SIGKILL)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if time.monotonic() > end:
        raise subprocess.TimeoutExpired(command, timeout)
    return subprocess.CompletedProcess(command, status, said)
