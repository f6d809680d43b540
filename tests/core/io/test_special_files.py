"""Pipes and devices in place of files that a reader opens, and byte order marks in text."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agglo_core import AggloError, FileError, Pipeline, interchange, read, samples, write
from agglo_core.problems import read_problem

MARK = b"\xef\xbb\xbf"
PVTU = (
    '<VTKFile type="PUnstructuredGrid" version="1.0"><PUnstructuredGrid>'
    '<Piece Source="m0.vtu"/></PUnstructuredGrid></VTKFile>'
)
TETGEN = "1 4 0\n1 1 2 3 4\n"
ABAQUS = "*NODE\n1,0,0,0\n2,1,0,0\n3,0,1,0\n*ELEMENT, TYPE=CPS3\n1,1,2,3\n*INCLUDE, INPUT=more.inp\n"
XDMF = """<Xdmf Version="3.0"><Domain><Grid Name="Grid">
<Geometry GeometryType="XY">
<DataItem DataType="Float" Dimensions="3 2" Format="HDF" Precision="8">m.h5:/data0</DataItem>
</Geometry><Topology TopologyType="Triangle" NumberOfElements="1" NodesPerElement="3">
<DataItem DataType="Int" Dimensions="1 3" Format="HDF" Precision="8">m.h5:/data1</DataItem>
</Topology></Grid></Domain></Xdmf>"""


def pipe(file: Path) -> None:
    os.mkfifo(file)


def device(file: Path) -> None:
    file.symlink_to("/dev/zero")


special = pytest.mark.parametrize("make", [pipe, device])
pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes of POSIX")


@pytest.mark.usefixtures("forked_readers")
@special
@pytest.mark.parametrize(
    ("first", "text", "second"),
    [
        ("m.ele", "1 0\n", "m.node"),
        ("m.ele", TETGEN, "m.node"),
        ("m.node", "4 3 0 0\n", "m.ele"),
        ("m.pvtu", PVTU, "m0.vtu"),
        ("m.inp", ABAQUS, "more.inp"),
        ("m.xdmf", XDMF, "m.h5"),
    ],
)
def test_second_files_of_meshes(
    tmp_path: Path, make: Callable[[Path], None], first: str, text: str, second: str
) -> None:
    if first == "m.xdmf":
        pytest.importorskip("h5py")
    (tmp_path / first).write_text(text)
    make(tmp_path / second)
    with pytest.raises(FileError, match=rf"{second}.*: is not a regular file"):
        read(tmp_path / first)


@special
@pytest.mark.parametrize("name", ["points", "boundary", "cellZones", "owner.gz"])
def test_files_of_a_case(tmp_path: Path, make: Callable[[Path], None], name: str) -> None:
    """What is no regular file is none of the case: an optional one is passed over."""
    write(tmp_path / "m.foam", samples.boxes(2))
    poly = tmp_path / "constant" / "polyMesh"
    (poly / name.removesuffix(".gz")).unlink(missing_ok=True)
    make(poly / name)
    if name == "cellZones":
        assert read(tmp_path / "m.foam").n_cells == 8
        return
    with pytest.raises(FileError, match=f"neither .*{name.removesuffix('.gz')} nor"):
        read(tmp_path / "m.foam")


@special
def test_special_files_are_refused_by_all_other_readers(tmp_path: Path, make: Callable[[Path], None]) -> None:
    file = tmp_path / "special.toml"
    make(file)
    (tmp_path / "m.graph").write_text("2 1\n2\n1\n")
    mesh, places = samples.squares(1), np.zeros((2, 2))
    readers: list[Callable[[], Any]] = [
        lambda: read(file),
        lambda: Pipeline.from_toml(file),
        lambda: read_problem(file, mesh),
        lambda: interchange.graph_from_metis(file, places),
        lambda: interchange.graph_from_metis(tmp_path / "m.graph", file),
        lambda: interchange.parts_from_metis(file),
        lambda: interchange.graph_from_scotch(file, places),
        lambda: interchange.parts_from_scotch(file),
    ]
    for reader in readers:
        with pytest.raises(FileError, match=r"special\.toml: is not a regular file"):
            reader()


@pytest.mark.usefixtures("forked_readers")
@pytest.mark.parametrize(
    "suffix",
    [*(".vtu", ".obj", ".off", ".ply", ".typ2", ".vtk", ".msh", ".mesh"), ".hedra", ".ovm", ".ele", ".foam"],
)
def test_byte_order_marks_in_meshes(tmp_path: Path, suffix: str) -> None:
    plane = suffix not in (".hedra", ".ovm", ".ele", ".foam")
    made = samples.triangles(3) if plane else samples.boxes(2)
    write(tmp_path / f"m{suffix}", made)
    mesh = read(tmp_path / f"m{suffix}")
    for file in [each for each in tmp_path.rglob("*") if each.is_file()]:
        file.write_bytes(MARK + file.read_bytes())
    assert read(tmp_path / f"m{suffix}").fingerprint == mesh.fingerprint
    if suffix in (".off", ".ply", ".typ2", ".ovm", ".vtu"):
        (tmp_path / f"m{suffix}").rename(tmp_path / "m.other")
        assert read(tmp_path / "m.other").fingerprint == mesh.fingerprint


def test_byte_order_marks_before_the_first_point(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_bytes(MARK + b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 4 3\n")
    assert read(tmp_path / "m.obj").points.tolist() == [[0, 0], [1, 0], [0, 1], [1, 1]]
    (tmp_path / "m.ele").write_bytes(MARK + TETGEN.encode())
    (tmp_path / "m.node").write_bytes(MARK + b"4 3 0 0\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n")
    for name in ("m.ele", "m.node"):
        assert read(tmp_path / name).cell_measures.tolist() == pytest.approx([1 / 6])


def test_byte_order_marks_in_graphs(tmp_path: Path) -> None:
    texts = {
        "m.graph": "2 1\n2\n1\n",
        "xyz": "0 0\n1 0\n",
        "part": "1\n0\n",
        "m.grf": "0\n2 2\n0 0\n1 1\n1 0\n",
    }
    texts["map"] = "2\n0 1\n1 0\n"
    for name, text in texts.items():
        (tmp_path / name).write_bytes(MARK + text.encode())
    for graph in (
        interchange.graph_from_metis(tmp_path / "m.graph", tmp_path / "xyz"),
        interchange.graph_from_scotch(tmp_path / "m.grf", tmp_path / "xyz"),
    ):
        assert graph.indices.tolist() == [1, 0]
        assert np.diff(graph.centroids, axis=0).tolist() == [[1, 0]]
    assert interchange.parts_from_metis(tmp_path / "part").tolist() == [1, 0]
    assert interchange.parts_from_scotch(tmp_path / "map").tolist() == [1, 0]


def test_a_mark_within_a_text_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "m.off").write_bytes(MARK + MARK + b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    with pytest.raises(AggloError, match=r"m\.off: it does not begin with OFF"):
        read(tmp_path / "m.off")
