"""VTKHDF: round trips, what VTK itself writes, faults by name. Skipped without h5py."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agglo_core import AggloError, FileError, Mesh, agglomerate, read, read_hierarchy, samples, write
from agglo_core.io.vtk.vtkhdf import VtkHdf

MESHES = {
    "polygons": lambda: samples.voronoi(90, seed=2),
    "polyhedra": lambda: samples.voronoi3d(20),
    "tetrahedra": lambda: samples.tetrahedra(2),
}


@pytest.fixture
def h5py() -> Any:
    return pytest.importorskip("h5py")


@pytest.mark.parametrize("compress", [False, True])
@pytest.mark.parametrize("name", MESHES)
def test_what_is_written_comes_back(name: str, compress: bool, h5py: Any, tmp_path: Path) -> None:
    mesh = MESHES[name]().with_tags(rock=lambda x: x[:, 0] < 0.4)
    mesh = mesh.with_face_tags(inlet=lambda x: np.isclose(x[:, 0], 0), number=np.arange(mesh.n_faces) % 3)
    hierarchy = agglomerate(mesh, bisector="coordinate", n_parts=(8, 2))
    write(tmp_path / "m.vtkhdf", mesh, hierarchy, compress=compress)
    write(tmp_path / "m.vtu", mesh, hierarchy)
    back, levels = read_hierarchy(tmp_path / "m.vtkhdf")
    same = read(tmp_path / "m.vtu")
    assert levels is not None
    for array in ("points", "face_offsets", "face_vertices", "face_cells"):
        assert np.array_equal(getattr(back, array), getattr(same, array))
    assert [level.tolist() for level in levels.levels] == [level.tolist() for level in hierarchy.levels]
    assert back.cell_tags["rock"].tolist() == mesh.cell_tags["rock"].tolist()
    for tag in ("inlet", "number"):
        assert back.face_tags[tag].tolist() == same.face_tags[tag].tolist()
    assert read(tmp_path / "m_level0.vtkhdf").n_cells == 8
    with h5py.File(tmp_path / "m_level0.vtkhdf") as file:
        assert file["VTKHDF/CellData/parent"].shape == (8,)
        np.testing.assert_allclose(file["VTKHDF/CellData/measure"], hierarchy.mesh(0).cell_measures)


def test_earlier_levels_go(h5py: Any, tmp_path: Path) -> None:
    mesh = samples.squares(4)
    write(tmp_path / "m.vtkhdf", mesh, agglomerate(mesh, bisector="coordinate", n_parts=(8, 4, 2)))
    (tmp_path / "m_level9.vtkhdf").write_bytes(b"another's")
    write(tmp_path / "m.vtkhdf", mesh, agglomerate(mesh, bisector="coordinate", n_parts=8))
    left = sorted(each.name for each in tmp_path.iterdir())
    assert left == ["m.vtkhdf", "m_level0.vtkhdf", "m_level9.vtkhdf"]


def two_partitions(h5py: Any, path: Path, **changed: Any) -> Path:
    """A square each, one beside the other, the second with point and cell numbers of its own."""
    arrays = {
        "NumberOfPoints": [4, 4],
        "NumberOfCells": [1, 1],
        "NumberOfConnectivityIds": [4, 4],
        "Points": [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [1, 0, 0], [2, 0, 0], [2, 1, 0], [1, 1, 0.0]],
        "Connectivity": [0, 1, 2, 3, 0, 1, 2, 3],
        "Offsets": [0, 4, 0, 4],
        "Types": np.array([9, 7], np.uint8),
        "CellData/rock": [5, 6],
        "CellData/speed": [0.5, 0.25],
        **changed,
    }
    with h5py.File(path, "w") as file:
        group = file.create_group("VTKHDF")
        group.attrs["Version"], group.attrs["Type"] = [2, 0], np.bytes_(b"UnstructuredGrid")
        for name, values in arrays.items():
            if values is not None:
                group[name] = values
    return path


def test_partitions_are_joined(h5py: Any, tmp_path: Path) -> None:
    mesh = read(two_partitions(h5py, tmp_path / "m.vtkhdf"))
    assert mesh.cell_measures.tolist() == [1, 1]
    assert mesh.graph.interface.tolist() == [1, 1]
    assert mesh.cell_tags["rock"].tolist() == [5, 6]
    assert mesh.repairs["cell data that are not integers left out"] == 1


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"Points": None}, "'Points' is missing"),
        ({"Types": None}, "'Types' is missing"),
        ({"Types": [9]}, r"'Types' has the shape \(1,\)"),
        ({"Offsets": [0, 4, 1, 4]}, "'Offsets' begins with 1"),
        ({"Offsets": [0, 3, 0, 4]}, "must increase to 4, but it ends at 3"),
        ({"Offsets": [0.0, 4, 0, 4]}, "'Offsets' must hold integers"),
        ({"Connectivity": [0, 1, 2, 3, 0, 1, 2, 4]}, r"points outside 0\.\.3"),
        ({"NumberOfPoints": [4]}, "given for 1 partitions"),
        ({"NumberOfCells": [1, -1]}, "not valid counts"),
        ({"NumberOfCells": [1, 10_000_000]}, "a Piece of 10000000 cells|has 2 values"),
        ({"CellData/rock": [5]}, "cell data 'rock' has 1 values for 2"),
        ({"Types": np.array([9, 99], np.uint8)}, "VTK cell type 99"),
        ({"Steps/NSteps": 3}, "time steps"),
        ({"Points": [["a"]]}, "is not numeric|HDF5"),
    ],
)
def test_faults_are_named(changed: dict[str, Any], says: str, h5py: Any, tmp_path: Path) -> None:
    with pytest.raises(AggloError, match=says) as error:
        read(two_partitions(h5py, tmp_path / "m.vtkhdf", **changed))
    assert str(error.value).startswith(str(tmp_path / "m.vtkhdf"))


def test_other_content_is_refused(h5py: Any, tmp_path: Path) -> None:
    file = tmp_path / "m.vtkhdf"
    file.write_bytes(b"\x89HDF\r\n\x1a\nand no more")
    with pytest.raises(FileError, match="HDF5 cannot read it"):
        read(file)
    with h5py.File(file, "w") as found:
        found["a"] = [1]
    with pytest.raises(FileError, match="without the group 'VTKHDF'"):
        read(file)
    two_partitions(h5py, file)
    with h5py.File(file, "a") as found:
        found["VTKHDF"].attrs["Type"] = np.bytes_(b"PolyData")
    with pytest.raises(FileError, match="holds a PolyData"):
        read(file)


def test_arrays_of_other_files_are_refused(h5py: Any, tmp_path: Path) -> None:
    other = two_partitions(h5py, tmp_path / "other.vtkhdf")
    file = two_partitions(h5py, tmp_path / "m.vtkhdf", Types=None)
    with h5py.File(file, "a") as found:
        found["VTKHDF/Types"] = h5py.ExternalLink(other, "/VTKHDF/Types")
    with pytest.raises(FileError, match="'Types' is a link, expected a dataset"):
        read(file)


@pytest.mark.parametrize("kind", ["external", "soft"])
@pytest.mark.parametrize("group", ["VTKHDF", "VTKHDF/CellData", "VTKHDF/FieldData", "VTKHDF/CellData/rock"])
def test_links_are_refused(group: str, kind: str, h5py: Any, tmp_path: Path) -> None:
    """Groups and cell data of another file, reached directly or by a soft link through an external one."""
    other = tmp_path / "other.vtkhdf"
    write(other, samples.squares(2).with_tags(rock=[1, 2, 3, 4]).with_face_tags(inlet=[1] * 12))
    file = tmp_path / "m.vtkhdf"
    write(file, samples.squares(2).with_tags(rock=[5, 6, 7, 8]))
    with h5py.File(file, "a") as found:
        found["elsewhere"] = h5py.ExternalLink(other, "/")
        if group in found:
            del found[group]
        found[group] = (
            h5py.ExternalLink(other, group) if kind == "external" else h5py.SoftLink(f"/elsewhere/{group}")
        )
    name = group.split("/")[-1]
    with pytest.raises(FileError, match=f"{name!r} is a link, expected a (group|dataset)"):
        read(file)


@pytest.mark.usefixtures("forked_readers")
@pytest.mark.parametrize("kind", ["group", "dataset", "virtual", "raw"])
def test_parts_of_other_hdf5_files_are_refused(kind: str, h5py: Any, tmp_path: Path) -> None:
    """MED files, which the package meshlane reads."""
    import meshlane

    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    for name in ("m.med", "other.med"):
        meshlane.Mesh(points[:, :2], [("triangle", np.array([[0, 1, 2]]))]).write(tmp_path / name)
    assert read(tmp_path / "m.med").cell_measures.tolist() == [0.5]
    with h5py.File(tmp_path / "m.med", "a") as found:
        names: list[str] = []
        found.visit(names.append)
        path = next(each for each in names if each.endswith("MAI/TR3/NOD"))
        path = path.removesuffix("/TR3/NOD") if kind == "group" else path
        values = None if kind == "group" else found[path][()]
        del found[path]
        if kind in ("group", "dataset"):
            found[path] = h5py.ExternalLink("other.med", path)
        elif kind == "virtual":
            layout = h5py.VirtualLayout(values.shape, values.dtype)
            layout[:] = h5py.VirtualSource("other.med", path, values.shape)
            found.create_virtual_dataset(path, layout)
        else:
            found.create_dataset(path, values.shape, values.dtype, external=[("other.med", 0, 64)])
    with pytest.raises(FileError, match=r"MAI.* is stored in another file"):
        read(tmp_path / "m.med")


def test_declared_but_missing_data_take_no_memory(h5py: Any, tmp_path: Path) -> None:
    """A terabyte that nobody wrote, and gigabytes of zeros in a few bytes."""
    file = two_partitions(h5py, tmp_path / "m.vtkhdf", Points=None)
    with h5py.File(file, "a") as found:
        found["VTKHDF"].create_dataset("Points", shape=(1 << 36, 3), dtype="f8", chunks=(1 << 16, 3))
    with pytest.raises(FileError, match="'Points' declares"):
        read(file)


def test_without_h5py_the_error_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(FileError, match=r"VTKHDF needs h5py: pip install agglo\[hdf\]"):
        VtkHdf().write(tmp_path / "m.vtkhdf", samples.squares(2))
    (tmp_path / "m.vtkhdf").write_bytes(b"\x89HDF\r\n\x1a\n")
    with pytest.raises(FileError, match=r"VTKHDF needs h5py"):
        VtkHdf().read(tmp_path / "m.vtkhdf")


def test_a_name_that_hdf5_cannot_hold(h5py: Any, tmp_path: Path) -> None:
    mesh: Mesh = samples.squares(2).with_tags(**{"a/b": [1, 2, 3, 4]})
    with pytest.raises(FileError, match="a tag named 'a/b'"):
        write(tmp_path / "m.vtkhdf", mesh)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", MESHES)
def test_vtk_opens_it_and_writes_the_same(name: str, h5py: Any, tmp_path: Path) -> None:
    pyvista = pytest.importorskip("pyvista")
    vtk = pytest.importorskip("vtk")
    mesh = MESHES[name]().with_tags(rock=lambda x: x[:, 0] < 0.4)
    write(tmp_path / "m.vtkhdf", mesh)
    grid = pyvista.read(tmp_path / "m.vtkhdf")
    assert grid.n_cells == mesh.n_cells
    assert grid.cell_data["rock"].tolist() == mesh.cell_tags["rock"].tolist()
    writer = vtk.vtkHDFWriter()
    writer.SetFileName(str(tmp_path / "by_vtk.vtkhdf"))
    writer.SetInputData(grid)
    writer.Write()
    back = read(tmp_path / "by_vtk.vtkhdf")
    np.testing.assert_allclose(back.cell_measures, mesh.cell_measures, rtol=1e-14)
    assert back.cell_tags["rock"].tolist() == mesh.cell_tags["rock"].tolist()
