"""Read a file with meshlane and save its cells as ``.npz``, in a process of its own.

meshlane prints, exits, and on some truncated files never ends. A separate process with limits on processor
time and memory contains all of this.
"""

from __future__ import annotations

import io
import json
import os
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from agglo_core.arrays import Int, frozen_float, frozen_int
from agglo_core.errors import FileError
from agglo_core.io.tags import tag_values
from agglo_core.io.to_mesh.soup import Soup
from agglo_core.mesh.elements import Polyhedra, concatenate

_WEDGE = (0, 2, 1, 3, 5, 4)  # meshlane keeps Gmsh's order, whose first triangle looks inward
# meshlane type without digits: VTK type of the linear cell, VTK type with more nodes, number of corners
_KINDS = {
    "vertex": (1, 1, 1),
    "line": (3, 68, 2),
    "triangle": (5, 69, 3),
    "quad": (9, 70, 4),
    "polygon": (7, 7, 0),
    "tetra": (10, 71, 4),
    "hexahedron": (12, 72, 8),
    "wedge": (13, 73, 6),
    "pyramid": (14, 74, 5),
    "VTK_LAGRANGE_CURVE": (68, 68, 2),
    "VTK_LAGRANGE_TRIANGLE": (69, 69, 3),
    "VTK_LAGRANGE_QUADRILATERAL": (70, 70, 4),
    "VTK_LAGRANGE_TETRAHEDRON": (71, 71, 4),
    "VTK_LAGRANGE_HEXAHEDRON": (72, 72, 8),
    "VTK_LAGRANGE_WEDGE": (73, 73, 6),
    "VTK_LAGRANGE_PYRAMID": (74, 74, 5),
}


def main(source: str, target: str, seconds: int, memory: int) -> int:
    """Read ``source`` with meshlane and save its cells in the ``.npz`` file ``target``.

    On failure print the reason and return 1.
    """
    output, result = io.StringIO(), sys.stdout
    try:
        with redirect_stdout(output), redirect_stderr(output), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import meshlane

            _limit(seconds, memory)
            _refuse_links(source)
            with _refuse_special_files(source):
                mesh = meshlane.read(source)
            sets = sorted({*mesh.cell_sets, *_families(mesh)})
            _save(soup_from_meshlane(mesh), sets, list(mesh.cell_data), target)
    except FileError as error:
        print(error, file=result)
    except (Exception, SystemExit) as error:
        printed = " ".join(output.getvalue().split())
        print(printed if isinstance(error, SystemExit) else f"{type(error).__name__}: {error}", file=result)
    else:
        return 0
    return 1


@contextmanager
def _refuse_special_files(source: str) -> Iterator[None]:
    """Reject pipes and devices that meshlane might open, because reading them may never end."""
    active = True

    def refuse(path: object) -> None:
        if active and isinstance(path, str | bytes | os.PathLike) and os.fsdecode(path) != os.devnull:
            file = Path(os.fsdecode(path))
            if file.exists() and not file.is_file() and not file.is_dir():
                raise FileError(f"{file.name}: is not a regular file")

    sys.addaudithook(lambda event, args: refuse(args[0]) if event == "open" else None)
    if source.lower().endswith((".xdmf", ".xmf")):  # refers to HDF5 files, which Python does not open
        _check_hdf5_files(refuse)
    try:
        yield
    finally:
        active = False  # audit hooks cannot be removed


def _check_hdf5_files(check: Callable[[object], None]) -> None:
    """Make h5py call ``check`` for each HDF5 file that it opens."""
    try:
        import h5py
    except ImportError:
        return

    class CheckedFile(h5py.File):  # type: ignore[misc]
        def __init__(self, name: object, *args: Any, **options: Any) -> None:
            check(name)
            super().__init__(name, *args, **options)

    h5py.File = CheckedFile


def _refuse_links(source: str) -> None:
    """Raise FileError if an HDF5 file (MED, CGNS, H5M) refers to data in other files."""
    with open(source, "rb") as file:
        if file.read(8) != b"\x89HDF\r\n\x1a\n":
            return
    try:
        import h5py
    except ImportError:  # meshlane cannot read it either and reports this
        return

    with h5py.File(source, "r") as file:

        def elsewhere(name: str, link: Any) -> str | None:
            if isinstance(link, h5py.ExternalLink):
                return name
            stored = file[name] if isinstance(link, h5py.HardLink) else None
            return (
                name if isinstance(stored, h5py.Dataset) and (stored.is_virtual or stored.external) else None
            )

        name = file.visititems_links(elsewhere)
    if name is not None:
        raise FileError(f"{name!r} is stored in another file, which is not supported")


def _limit(seconds: int, memory: int) -> None:
    """Limit the processor time (s) and the additional memory (bytes) of this process, if possible."""
    try:
        import resource
    except ImportError:  # Windows: only the caller's time limit applies
        return
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    memory += _address_space(resource.getpagesize())
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))


def _address_space(page: int) -> int:
    """Return the memory in use by this process in bytes, or an upper bound if unknown."""
    try:
        return page * int(Path("/proc/self/statm").read_text().split()[0])
    except (OSError, ValueError):
        return 8 << 30


def _save(soup: Soup, sets: list[str], data: list[str], target: str) -> None:
    skipped_names = [name for name in data if name not in soup.tags]
    names = json.dumps({"tags": list(soup.tags), "sets": sets, "left": skipped_names}).encode()
    tags = {f"tag_{i}": values for i, values in enumerate(soup.tags.values())}
    with open(target, "wb") as file:
        np.savez(
            file,
            allow_pickle=False,
            names=np.frombuffer(names, np.uint8),
            points=soup.points,
            types=soup.types,
            offsets=soup.offsets,
            vertices=soup.vertices,
            cell_offsets=soup.solids.cell_offsets,
            loop_offsets=soup.solids.loop_offsets,
            loops=soup.solids.vertices,
            **tags,
        )


def soup_from_meshlane(found: Any) -> Soup:
    """Concatenate the cell blocks of a meshlane mesh."""
    points = np.asarray(found.points, dtype=np.float64)
    if points.ndim == 2 and points.shape[1] == 1:
        raise FileError("it holds a 1-D mesh, expected a 2-D or 3-D one")
    # Convert block by block, then concatenate.
    parts = [_block(block.type, block.data) for block in found.cells]
    sizes = np.concatenate([np.empty(0, np.int64), *(np.diff(part[1]) for part in parts)])
    counts = [len(part[0]) for part in parts]
    vertices = np.concatenate([np.empty(0, np.int64), *(part[2] for part in parts)])
    solids = concatenate([part[3] for part in parts])
    # meshlane does not check point numbers.
    for name, used in (("cells", vertices), ("faces", solids.vertices)):
        if used.size and (used.min() < 0 or used.max() >= len(points)):
            raise FileError(f"its {name} use points outside 0..{len(points) - 1}")
    return Soup(
        frozen_float(points),
        frozen_int(np.concatenate([np.empty(0, np.int64), *(part[0] for part in parts)])),
        frozen_int(np.concatenate(([0], np.cumsum(sizes)))),
        frozen_int(vertices),
        solids,
        {
            **_family_tags(found, counts),
            **_data_tags(found, counts),
            **_set_tags(found, counts),
        },
    )


def _block(name: str, data: Any) -> tuple[Int, Int, Int, Polyhedra]:
    """Convert a block of meshlane cells to VTK types, offsets and nodes, and polyhedra to faces per cell."""
    none = concatenate([])
    if name.startswith("polyhedron"):
        solids = _polyhedra(data)
        n = len(solids.cell_offsets) - 1
        return frozen_int(np.full(n, 42)), frozen_int(np.zeros(n + 1)), frozen_int([]), solids
    kind = name.rstrip("0123456789")
    if kind not in _KINDS:
        raise FileError(f"its cells of type {name!r} are not supported")
    linear, curved, corners = _KINDS[kind]
    rows = (
        data if isinstance(data, np.ndarray) and data.ndim == 2 else [np.asarray(row).ravel() for row in data]
    )
    sizes = np.array([len(row) for row in rows], np.int64)
    nodes = np.concatenate([np.empty(0, np.int64), *rows]).astype(np.int64)
    if kind == "wedge" and len(rows):
        nodes = np.asarray(rows)[:, [*_WEDGE, *range(6, len(rows[0]))]].astype(np.int64).ravel()
    types = np.where((corners == 0) | (sizes == corners), linear, curved)
    return frozen_int(types), frozen_int(np.concatenate(([0], np.cumsum(sizes)))), frozen_int(nodes), none


def _polyhedra(cells: Any) -> Polyhedra:
    loops = [np.asarray(loop, dtype=np.int64) for cell in cells for loop in cell]
    counts, sizes = [len(cell) for cell in cells], [len(loop) for loop in loops]
    return Polyhedra(
        frozen_int(np.concatenate(([0], np.cumsum(counts)))),
        frozen_int(np.concatenate(([0], np.cumsum(sizes)))),
        frozen_int(np.concatenate([np.empty(0, np.int64), *loops])),
    )


def _data_tags(mesh: Any, counts: list[int]) -> dict[str, Int]:
    """Return as tags the integer cell data with one component that exist on all blocks.

    MDPA files store all data as real numbers; arrays of whole values become integers.
    """
    tags = {}
    real = any(name.startswith("gmsh:") for name in mesh.cell_data)
    for name, blocks in mesh.cell_data.items():
        arrays = [np.asarray(block) for block in blocks]
        arrays = [array.ravel() if array.shape[1:] == (1,) else array for array in arrays]
        if real:
            arrays = _convert_whole(arrays)
        whole = all(a.shape == (n,) and a.dtype.kind in "iu" for a, n in zip(arrays, counts, strict=True))
        if whole and arrays:
            tags[name] = tag_values(name, np.concatenate(arrays))
    return tags


def _convert_whole(arrays: list[Any]) -> list[Any]:
    """Convert floating-point arrays to integers if all their values are integers."""
    real = [array for array in arrays if array.dtype.kind == "f"]
    whole = all((np.abs(array) < 2**53).all() and (array == np.floor(array)).all() for array in real)
    return [array.astype(np.int64) for array in arrays] if real and whole else arrays


def _set_tags(mesh: Any, counts: list[int]) -> dict[str, Int]:
    """Return named cell sets as tags: 1 inside, 0 outside."""
    tags = {}
    starts = np.cumsum([0, *counts])
    for name, blocks in mesh.cell_sets.items():
        if name.startswith("gmsh:") or len(blocks) != len(counts):
            continue
        inside = np.zeros(starts[-1], np.int64)
        for start, block in zip(starts[:-1], blocks, strict=True):
            if block is not None and len(block):
                inside[start + np.asarray(block, dtype=np.int64)] = 1
        tags[name] = frozen_int(inside)
    return tags


def _families(mesh: Any) -> dict[str, list[int]]:
    """Return the numbers of the cell families in each named group (OpenFOAM patches, MED groups)."""
    families: dict[str, list[int]] = {}
    for number, names in (getattr(mesh, "cell_tags", None) or {}).items():
        for name in names:
            families.setdefault(str(name), []).append(int(number))
    return families


def _family_tags(mesh: Any, counts: list[int]) -> dict[str, Int]:
    """Return named cell groups as tags: 1 inside, 0 outside.

    The cell data ``cell_tags`` hold the family of each cell.
    """
    blocks = mesh.cell_data.get("cell_tags", [])
    if len(blocks) != len(counts) or not blocks:
        return {}
    family = np.concatenate([np.asarray(block).ravel() for block in blocks])
    if len(family) != sum(counts):
        return {}
    return {
        name: frozen_int(np.isin(family, numbers).astype(np.int64))
        for name, numbers in _families(mesh).items()
    }


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])))
