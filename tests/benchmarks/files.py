"""Measure writing and reading of files: CPU seconds, MB/s and peak memory, next to numpy and meshio.

    python tests/benchmarks/files.py [CELLS ...] [--repeats N] [--ways NAME,…] [--chain]

Random Delaunay triangles, Voronoi cells, tetrahedra, and agglomerates of eight tetrahedra, one thread. Each
call has its own process, warmed up on a small mesh, and a mesh without derived data. Seconds are CPU
seconds, minimum over alternating repeats. MB/s is file size over seconds, and "by VTU" is reading time over
that of VTU. Binary OpenFOAM cases are written here, in the layout of OpenFOAM. B/cell is the peak growth of
resident memory, including the mesh that is read (Linux only). ``numpy.savez`` and ``numpy.load`` store the
same mesh arrays without checks. meshio and pyvista, if installed, store the points and the vertex lists of
triangles, polygons and tetrahedra as VTU, without faces.

The table of the chain gives the CPU seconds of ``agglo run FILE.vtu --h-factor 2,4,8 -o out.vtu`` by phase,
with cells and points as made, along a Hilbert curve, and in random order. B/cell is the peak of the chain.
"""

from __future__ import annotations

import os

for _variable in ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"  # before numpy is imported

# ruff: noqa: E402
import argparse
import importlib.util
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agglo_core import Mesh, agglomerate, read, samples, write
from agglo_core.arrays import Float, Int
from agglo_core.graph.ordering import curve_order
from agglo_core.io.vtk.cells import cells_of
from agglo_core.measure import measure_levels

ARRAYS = ("points", "face_offsets", "face_vertices", "face_cells")
STATUS = Path("/proc/self/status")
Write = Callable[[Path, Mesh], Any]
Read = Callable[[Path], Any]


class Way(NamedTuple):
    """Method to write a mesh and to read it back."""

    name: str
    suffix: str
    write: Write
    read: Read
    dims: tuple[int, ...] = (2, 3)


def ways() -> Iterator[Way]:
    """Yield all methods available here."""
    yield Way("agglo vtu", ".vtu", write, read)
    yield Way("agglo npz", ".npz", write, read)
    yield Way("agglo vtu, compress", ".vtu", lambda file, mesh: write(file, mesh, compress=True), read)
    yield Way("agglo npz, compress", ".npz", lambda file, mesh: write(file, mesh, compress=True), read)
    yield Way("agglo typ2", ".typ2", write, read, (2,))
    yield Way("agglo mat", ".mat", write, read)
    yield Way("agglo OpenFOAM", ".foam", write, read, (3,))
    yield Way("OpenFOAM binary", ".foam", foam_binary, read, (3,))
    yield Way("agglo RF", ".ele", write, read, (3,))
    yield Way("numpy.savez", ".npz", numpy_write, lambda file: list(np.load(file).values()))
    if importlib.util.find_spec("h5py"):
        yield Way("agglo vtkhdf", ".vtkhdf", write, read)
    if importlib.util.find_spec("meshio"):
        import meshio

        yield Way("meshio vtu", ".vtu", meshio_write, meshio.read)
    if importlib.util.find_spec("pyvista"):
        import pyvista

        yield Way("pyvista vtu", ".vtu", pyvista_write, pyvista.read)


def numpy_write(file: Path, mesh: Mesh) -> None:
    """Write the arrays of the mesh without conversion."""
    np.savez(file, **{name: getattr(mesh, name) for name in ARRAYS})


def foam_binary(file: Path, mesh: Mesh) -> None:
    """Write a binary OpenFOAM case: 32-bit labels, points as doubles, faces in compact form."""
    write(file, mesh)
    poly = file.parent / "constant/polyMesh"
    points, faces = (parsed(poly / name) for name in ("points", "faces"))
    sizes = np.array([int(line.split(b"(")[0]) for line in faces], np.int32)
    starts = np.concatenate(([0], np.cumsum(sizes))).astype("<i4")
    corners = np.fromstring(b" ".join(line.split(b"(")[1].rstrip(b")") for line in faces), "<i4", sep=" ")
    places = np.fromstring(b" ".join(line.strip(b"()") for line in points), "<f8", sep=" ")
    lists = {"points": [(len(points), places)], "faces": [(len(starts), starts), (len(corners), corners)]}
    for name in ("owner", "neighbour"):
        values = np.array(parsed(poly / name), dtype=np.int32)
        lists[name] = [(len(values), values)]
    for name, arrays in lists.items():
        kind = {"points": "vectorField", "faces": "faceCompactList"}.get(name, "labelList")
        head = f'FoamFile\n{{\n format binary;\n arch "LSB;label=32;scalar=64";\n class {kind};\n}}\n'
        (poly / name).write_bytes(
            head.encode() + b"".join(b"%d\n(%b)\n" % (n, a.tobytes()) for n, a in arrays)
        )


def parsed(file: Path) -> list[bytes]:
    """Return the entries of a list in an OpenFOAM text file."""
    return file.read_bytes().split(b"\n(\n", 1)[1].rsplit(b"\n)", 1)[0].split(b"\n")


def blocks(mesh: Mesh) -> Iterator[tuple[str, Int]]:
    """Yield the vertex lists (n, k) of cells by kind; of 3-D meshes only of tetrahedra."""
    if mesh.dim == 3:
        yield "tetra", cells_of(mesh).vertices.reshape(-1, 4)
        return
    loops = mesh.boundary_loops
    sizes = np.diff(loops.loop_offsets)
    for size in np.unique(sizes).tolist():
        start = loops.loop_offsets[:-1][sizes == size]
        kind = {3: "triangle", 4: "quad"}.get(size, "polygon")
        yield kind, loops.vertices[start[:, None] + np.arange(size)]


def space_points(mesh: Mesh) -> Float:
    """Return the points (n_points, 3), with a zero coordinate in 2-D."""
    return np.pad(mesh.points, ((0, 0), (0, 3 - mesh.dim)))


def meshio_write(file: Path, mesh: Mesh) -> None:
    """Write a block of cells per number of vertices, uncompressed."""
    import meshio

    meshio.Mesh(space_points(mesh), list(blocks(mesh))).write(file, compression=None)


def pyvista_write(file: Path, mesh: Mesh) -> None:
    """Write an unstructured grid as raw appended data."""
    import pyvista

    kinds = {"triangle": 5, "quad": 9, "polygon": 7, "tetra": 10}
    found = list(blocks(mesh))
    lists = [np.insert(cells, 0, cells.shape[1], axis=1).ravel() for _, cells in found]
    types = np.repeat([kinds[kind] for kind, _ in found], [len(cells) for _, cells in found])
    pyvista.UnstructuredGrid(np.concatenate(lists), types.astype(np.uint8), space_points(mesh)).save(file)


def load(arrays: Path) -> Mesh:
    """Load a mesh without derived data."""
    with np.load(arrays) as given:
        return Mesh(**{name: given[name] for name in ARRAYS})


def measure(way: Way, action: str, arrays: Path, file: Path) -> tuple[float, float]:
    """Return CPU seconds to write or read the file, and the peak memory growth in bytes."""
    warm = file.parent / "warm" / f"warm{way.suffix}"  # separate: OpenFOAM cases share a folder
    warm.parent.mkdir(exist_ok=True)
    with np.load(arrays) as given:
        plane = given["points"].shape[1] == 2
    solids = samples.tetrahedra(4)
    for small in (samples.voronoi(300),) if plane else (solids, solids.coarsen(np.arange(384) // 2)):
        way.write(warm, small)
        way.read(warm)
    mesh = load(arrays) if action == "write" else None
    before = resident("VmRSS")
    if before:
        Path("/proc/self/clear_refs").write_text("5")  # reset the peak
    start = time.process_time()
    result = way.write(file, mesh) if mesh is not None else way.read(file)
    seconds = time.process_time() - start
    del result
    return seconds, resident("VmHWM") - before


PHASES = ("read", "graph", "agglomerate", "measure", "write")


def chain(file: Path) -> tuple[list[float], float]:
    """Return CPU seconds of the phases of ``agglo run``, and the peak growth of memory in bytes."""

    def run(source: Path) -> list[float]:
        times = [time.process_time()]
        mesh = read(source)
        times.append(time.process_time())
        _ = mesh.graph, mesh.h
        times.append(time.process_time())
        hierarchy = agglomerate(mesh, h_factor=(2, 4, 8))
        times.append(time.process_time())
        levels = measure_levels(mesh, hierarchy)
        times.append(time.process_time())
        write(file.with_name("out.vtu"), mesh, hierarchy, level_values=[level.values for level in levels])
        times.append(time.process_time())
        return np.diff(times).tolist()

    small = file.with_name("small.vtu")
    write(small, samples.tetrahedra(5) if read(file).dim == 3 else samples.voronoi(500))
    run(small)
    before = resident("VmRSS")
    if before:
        Path("/proc/self/clear_refs").write_text("5")  # reset the peak
    seconds = run(file)
    return seconds, resident("VmHWM") - before


def compare_chains(name: str, mesh: Mesh, repeats: int) -> None:
    """Print the phases of the chain for three orders of cells and points."""
    rng = np.random.default_rng(0)
    orders = {
        "as made": lambda: mesh,
        "along a curve": lambda: mesh.renumbered(curve_order(mesh.local_centroids)),
        "random": lambda: in_order(mesh, rng.permutation(mesh.n_cells), rng.permutation(mesh.n_points)),
    }
    print(f"\n{name}: {mesh.n_cells} cells, the chain from file to file, least of {repeats}, one thread")
    print(f"{'':16}" + "".join(f"{phase:>13}" for phase in (*PHASES, "all", "B/cell")))
    with tempfile.TemporaryDirectory() as folder:
        for order, make in orders.items():
            file = Path(folder) / "mesh.vtu"
            write(file, make())
            command = [sys.executable, __file__, "--chain-of", str(file)]
            found = [
                json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
                for _ in range(repeats)
            ]
            row = min((seconds for seconds, _ in found), key=sum)
            high = min(high for _, high in found) / mesh.n_cells
            print(f"{order:16}" + "".join(f"{each:13.3f}" for each in (*row, sum(row))) + f"{high:13.0f}")


def in_order(mesh: Mesh, cells: Int, points: Int) -> Mesh:
    """Return a mesh with its cells and points in a given order."""
    number = np.empty(mesh.n_points, np.int64)
    number[points] = np.arange(mesh.n_points)
    turned = mesh.renumbered(cells)
    faces = turned.face_offsets, number[turned.face_vertices], turned.face_cells
    place = np.empty((mesh.n_points, mesh.dim))
    place[number] = turned.points
    return Mesh(place, *faces)


def resident(line: str) -> float:
    """Return a process status line in bytes, or 0 if unavailable."""
    if not STATUS.exists():
        return 0.0
    return 1024.0 * float(STATUS.read_text().split(f"{line}:")[1].split()[0])


def size_of(way: Way, file: Path) -> int:
    """Return the bytes of a file together with its auxiliary files."""
    beside = {".foam": "constant/**/*", ".ele": f"{file.stem}.node"}.get(way.suffix)
    more = file.parent.glob(beside) if beside else ()
    return file.stat().st_size + sum(each.stat().st_size for each in more if each.is_file())


def compare(name: str, mesh: Mesh, repeats: int, chosen: list[str]) -> None:
    """Print the table of methods for a mesh.

    Each call has its own process.
    """
    found: dict[str, list[list[float]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        arrays = Path(folder) / "arrays.npz"
        numpy_write(arrays, mesh)
        known = [way for way in ways() if mesh.dim in way.dims and (not chosen or way.name in chosen)]
        for _, (place, way) in product(range(repeats), enumerate(known)):
            file = Path(folder) / f"{place}{way.suffix}"
            row: list[float] = []
            for action in ("write", "read"):
                command = [sys.executable, __file__, "--one", way.name, action, str(arrays), str(file)]
                row += json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
            found.setdefault(way.name, []).append([size_of(way, file) / 1e6, *row])
    print(f"\n{name}: {mesh.n_cells} cells, least of {repeats}, one thread")
    head = f"{'':22}{'MB':>8}{'write s':>10}{'MB/s':>8}{'B/cell':>8}{'read s':>10}{'MB/s':>8}"
    print(f"{head}{'B/cell':>8}{'by VTU':>8}")
    vtu = np.min(found["agglo vtu"], axis=0)[3] if "agglo vtu" in found else np.nan
    for name, rows in found.items():
        size, saved, high, took, top = np.min(rows, axis=0)
        print(
            f"{name:22}{size:8.1f}{saved:10.3f}{size / saved:8.0f}{high / mesh.n_cells:8.0f}"
            f"{took:10.3f}{size / took:8.0f}{top / mesh.n_cells:8.0f}{took / vtu:8.1f}"
        )


def main() -> None:
    """Compare the methods for each mesh size."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("cells", nargs="*", type=int, default=[200_000])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--one", nargs=4, help=argparse.SUPPRESS)  # way, action, arrays, file
    parser.add_argument("--chain-of", help=argparse.SUPPRESS)  # file
    parser.add_argument("--chain", action="store_true", help="the chain instead of the formats")
    parser.add_argument("--ways", default="", help="some of the ways, by name, with commas between")
    parser.add_argument("--meshes", default="random triangles,Voronoi,tetrahedra,agglomerated")
    options = parser.parse_args()
    if options.chain_of:
        print(json.dumps(chain(Path(options.chain_of))))
        return
    if options.one:
        name, action, arrays, file = options.one
        way = next(each for each in ways() if each.name == name)
        print(json.dumps(measure(way, action, Path(arrays), Path(file))))
        return
    chosen, meshes = [each for each in options.ways.split(",") if each], options.meshes.split(",")
    for cells in options.cells:
        for name, make in kinds(cells).items():
            if name in meshes and options.chain:
                compare_chains(name, make(), options.repeats)
            elif name in meshes:
                compare(name, make(), options.repeats, chosen)


def kinds(cells: int) -> dict[str, Callable[[], Mesh]]:
    """Return functions for meshes of about ``cells`` cells by name."""
    n = max(1, round((cells / 6) ** (1 / 3)))
    return {
        "random triangles": lambda: samples.random_triangles(cells // 2),
        "Voronoi": lambda: samples.voronoi(cells),
        "tetrahedra": lambda: samples.tetrahedra(n),
        "agglomerated": lambda: agglomerate(samples.tetrahedra(n), cells_per_part=8).mesh(0),
    }


if __name__ == "__main__":
    main()
