"""Pieces of locally refined meshes, as deal.II writes them: each cell with points of its own.

Vertices hang on faces of cells of other pieces, and the cells at one large face may be in several.
"""

from __future__ import annotations

import base64
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from core.io.test_io_pvtu import listing
from core.io.test_io_vtu import Writer
from numpy.typing import NDArray
from on_ranks import on_ranks
from scipy import sparse

from agglo_core import Pipeline, read
from agglo_core.distributed import Ranks, agglomerate, read as read_shared


def refined(dim: int, n: int, depth: int) -> NDArray[np.float64]:
    """Low corner and size of each cell ``(cells, dim + 1)``: n in a row, halved around a point."""
    corners = np.stack(np.meshgrid(*[np.arange(n) / n] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    cells = np.column_stack((corners, np.full(len(corners), 1 / n)))
    halves = np.stack(np.meshgrid(*[(0.0, 0.5)] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    for level in range(depth):
        size = 0.5**level / n
        near = np.abs(cells[:, :-1] + 0.5 * cells[:, -1:] - 0.6).max(axis=1) < 0.9 * size
        near &= cells[:, -1] == size
        children = cells[near, None, :-1] + size * halves
        small = np.full((*children.shape[:2], 1), size / 2)
        cells = np.concatenate((cells[~near], np.concatenate((children, small), axis=2).reshape(-1, dim + 1)))
    return cells


def corners_of(cells: NDArray[np.float64]) -> NDArray[np.float32]:
    """Points of cells one after the other, in the order of VTK; the domain is bent, with straight edges."""
    dim = cells.shape[1] - 1
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    unit = square if dim == 2 else np.vstack([np.insert(square, 2, k, axis=1) for k in (0, 1)])
    x = cells[:, None, :-1] + cells[:, None, -1:] * unit
    x = np.concatenate((x, np.zeros((*x.shape[:2], 3 - dim))), axis=2).reshape(-1, 3)
    return np.asarray(x @ [[3.0, 0.7, 0.2 * (dim - 2)], [-0.3, 2.0, 0], [0.1, 0.3, 1.1]], np.float32)


def dealii_file(cells: NDArray[np.float64]) -> str:
    """A file as DataOut of deal.II writes it: version 0.1, inline, deflated."""
    dim = cells.shape[1] - 1
    size = 2**dim

    def array(kind: str, values: NDArray[Any], more: str) -> str:
        packed = zlib.compress(values.tobytes())
        head = struct.pack("<4I", 1, values.nbytes, values.nbytes, len(packed))
        text = (base64.b64encode(each).decode() for each in (head, packed))
        return f'<DataArray type="{kind}" {more} format="binary">\n{"".join(text)}\n</DataArray>'

    n = len(cells)
    arrays = [
        array("Float32", corners_of(cells), 'NumberOfComponents="3"'),
        array("Int32", np.arange(n * size, dtype=np.int32), 'Name="connectivity"'),
        array("Int32", np.arange(size, n * size + 1, size, dtype=np.int32), 'Name="offsets"'),
        array("UInt8", np.full(n, {2: 9, 3: 12}[dim], np.uint8), 'Name="types"'),
        array("Float32", np.zeros(n * size, np.float32), 'Name="subdomain"'),
    ]
    return (
        '<?xml version="1.0" ?> \n<!-- \n# vtk DataFile Version 3.0\n-->\n<VTKFile type="UnstructuredGrid" '
        'version="0.1" compressor="vtkZLibDataCompressor" byte_order="LittleEndian">\n<UnstructuredGrid>\n'
        f'<Piece NumberOfPoints="{n * size}" NumberOfCells="{n}" >\n<Points>\n{arrays[0]}</Points>\n'
        f'<Cells>{"".join(arrays[1:4])}</Cells>\n<PointData Scalars="scalars">{arrays[4]}</PointData>\n'
        "</Piece>\n</UnstructuredGrid>\n</VTKFile>\n"
    )


def write_pieces(folder: Path, dim: int) -> None:
    """A mesh in three pieces, one next to the other, and one in which neighbours are in any of them."""
    cells = refined(dim, 6 if dim == 2 else 3, 3 if dim == 2 else 2)
    rng = np.random.default_rng(dim)
    for name, owner in (
        ("strips", np.minimum(3 * cells[:, 0], 2).astype(int)),
        ("mixed", rng.integers(3, size=len(cells))),
    ):
        sources = [f"{name}{dim}_0.{rank}.vtu" for rank in range(3)]
        for rank, source in enumerate(sources):
            (folder / source).write_text(dealii_file(cells[owner == rank]))
        (folder / f"{name}{dim}.pvtu").write_text(listing(*sources))


def neighbours(file: str) -> tuple[Any, list[float], float]:
    """Interfaces between cells by global ids, boundary of each and connectedness, from all ranks."""
    ranks = Ranks()
    mesh = read_shared(file, ranks)
    mesh.check()
    graph, own = mesh.local.graph, mesh.own
    rows = sparse.csr_array((graph.interface, graph.indices, graph.indptr), shape=(graph.n, graph.n))[own]
    rows = rows.tocoo()
    found = (mesh.global_ids[own][rows.row], mesh.global_ids[rows.col], rows.data)
    boundary = mesh.gather(graph.boundary[own])
    quality = agglomerate(mesh, Pipeline(cells_per_part=8)).quality(0)
    return found, boundary.tolist(), float(quality["connected"])


@pytest.mark.parametrize(("size", "dim"), [(2, 2), pytest.param(3, 3, marks=pytest.mark.slow)])
def test_hanging_vertices_are_found_across_ranks(tmp_path: Path, size: int, dim: int) -> None:
    """Neighbours, interfaces and boundary are those of the mesh that one process reads."""
    write_pieces(tmp_path, dim)
    for name in ("strips", "mixed"):
        file = tmp_path / f"{name}{dim}.pvtu"
        graph = read(file).graph
        whole = sparse.csr_array((graph.interface, graph.indices, graph.indptr), shape=(graph.n, graph.n))
        answers = on_ranks(size, neighbours, str(file))
        i, j, shared = (np.concatenate(each) for each in zip(*(found for found, *_ in answers), strict=True))
        found = sparse.coo_array((shared, (i, j)), shape=whole.shape).tocsr()
        assert found.nnz == whole.nnz
        assert abs(found - whole).max() < 1e-6
        np.testing.assert_allclose(answers[0][1], graph.boundary, rtol=0.0, atol=1e-6)
        assert [connected for *_, connected in answers] == [1.0] * size


def face_tags(file: str) -> Any:
    """Of the faces whose owner is on this rank."""
    mesh = read_shared(file, Ranks())
    owner = mesh.owners[mesh.local.face_cells[:, 0]]
    return mesh.local.face_tags["mat"][owner == mesh.ranks.rank].tolist()


def test_both_parts_of_a_split_face_have_its_tags(tmp_path: Path) -> None:
    """A large square, two small ones on another rank; lines say 7 below, 8 between them, 9 on the right."""
    large = [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]]
    small = [[2, 0, 0], [3, 0, 0], [3, 1, 0], [2, 1, 0], [3, 2, 0], [2, 2, 0]]
    pieces = (
        (large, [(9, [0, 1, 2, 3]), (3, [0, 1]), (3, [1, 2])], [4, 7, 8]),
        (small, [(9, [0, 1, 2, 3]), (9, [3, 2, 4, 5]), (3, [1, 2])], [5, 6, 9]),
    )
    for rank, (points, cells, tags) in enumerate(pieces):
        w = Writer()
        piece = w.piece(np.array(points, float), cells, data=w.array("mat", tags, "i4"))
        (tmp_path / f"{rank}.vtu").write_bytes(w.file(piece))
    (tmp_path / "all.pvtu").write_text(listing("0.vtu", "1.vtu"))
    answers = on_ranks(2, face_tags, str(tmp_path / "all.pvtu"))
    assert sorted(tag for tags in answers for tag in tags) == [-1] * 6 + [7, 8, 8, 9]
    assert sorted(read(tmp_path / "all.pvtu").face_tags["mat"].tolist()) == [-1] * 6 + [7, 8, 8, 9]
