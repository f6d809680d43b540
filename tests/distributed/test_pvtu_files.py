"""Distributed meshes as .pvtu: what ranks write, one process reads again as it was; all of it or nothing."""

from __future__ import annotations

import os
import signal
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from on_ranks import on_ranks

import agglo_core.distributed.own_pieces as own_pieces
from agglo_core import FileError, Mesh, read, samples
from agglo_core import write as write_whole
from agglo_core.distributed import DistributedMesh, Ranks, write


def ring() -> Mesh:
    """A plane mesh in which one cell has a hole."""
    around = np.isin(np.arange(36), [7, 8, 9, 13, 15, 19, 20, 21])
    return samples.squares(6).coarsen(np.where(around, 0, np.cumsum(~around)))


def tagged(mesh: Mesh) -> Mesh:
    """With cell tags of small and of large numbers, and a face tag."""
    cells, outer = np.arange(mesh.n_cells), mesh.face_cells[:, 1] < 0
    sides = np.where(outer, 1 + np.arange(mesh.n_faces) % 4, 0)
    tags = {"far": np.where(cells == 3, 1 << 40, cells), "half": cells % 2}
    return replace(mesh, cell_tags=tags, face_tags={"side": sides})


MESHES = {
    "plane": lambda: tagged(samples.voronoi(90, seed=5)),
    "solid": lambda: tagged(samples.boxes(3)),
    "ring": lambda: tagged(ring()),
    "few": lambda: samples.squares(2),
}


def shared(mesh: Mesh) -> DistributedMesh:
    ranks = Ranks()
    return DistributedMesh.scatter(mesh if ranks.rank == 0 else None, ranks)


def write_all(folder: str) -> None:
    for name, make in MESHES.items():
        write(Path(folder) / f"{name}.pvtu", shared(make()), compress=name == "solid")


@pytest.mark.parametrize("size", [1, 3, 6])
def test_what_ranks_write_is_read_as_what_one_process_writes(tmp_path: Path, size: int) -> None:
    on_ranks(size, write_all, str(tmp_path))
    for name, make in MESHES.items():
        mesh, again = make(), read(tmp_path / f"{name}.pvtu")
        write_whole(tmp_path / f"{name}.vtu", mesh)
        assert again.fingerprint == read(tmp_path / f"{name}.vtu").fingerprint
        assert again.n_points == mesh.n_points
        assert not again.repairs
        assert {key: tag.tolist() for key, tag in again.cell_tags.items()} == {
            key: tag.tolist() for key, tag in mesh.cell_tags.items()
        }
        assert again.face_tags.keys() == mesh.face_tags.keys()
        pieces = sorted(file.name for file in (tmp_path / name).iterdir())
        assert pieces == [f"{name}_{rank}.vtu" for rank in range(size)]


def test_the_list_declares_what_every_piece_has(tmp_path: Path) -> None:
    """Names, types and widths of arrays, also where only one rank has a large number or a hole."""
    on_ranks(3, write_all, str(tmp_path))
    for name in MESHES:
        root = ElementTree.fromstring((tmp_path / f"{name}.pvtu").read_bytes())
        for section in ("PointData", "CellData"):
            declared = [
                (each.get("Name"), each.get("type"))
                for each in root.iterfind(f"PUnstructuredGrid/P{section}/PDataArray")
            ]
            assert declared[-1] == (f"Global{section.removesuffix('Data')}Ids", "Int64")
            for piece in (tmp_path / name).iterdir():
                text = piece.read_bytes().partition(b"<AppendedData")[0] + b"</VTKFile>"
                found = ElementTree.fromstring(text).iterfind(f"UnstructuredGrid/Piece/{section}/DataArray")
                assert [(each.get("Name"), each.get("type")) for each in found] == declared


def test_vtk_reads_the_pieces_with_their_global_ids(tmp_path: Path) -> None:
    pyvista = pytest.importorskip("pyvista")
    on_ranks(3, write_all, str(tmp_path))
    grid = pyvista.read(tmp_path / "plane.pvtu")
    assert sorted(grid.GetCellData().GetGlobalIds().GetTuple1(i) for i in range(90)) == list(range(90))
    assert grid.GetPointData().GetGlobalIds() is not None
    assert sorted(grid.cell_data["far"]) == sorted(tagged(samples.voronoi(90, seed=5)).cell_tags["far"])


def test_ids_that_contradict_one_another_are_refused(tmp_path: Path) -> None:
    on_ranks(2, write_all, str(tmp_path))
    pieces = tmp_path / "plane"
    (pieces / "plane_0.vtu").replace(pieces / "plane_1.vtu")
    (pieces / "plane_0.vtu").write_bytes((pieces / "plane_1.vtu").read_bytes())
    with pytest.raises(FileError, match=r"cell \d+ is in several pieces"):
        read(tmp_path / "plane.pvtu")
    other = tmp_path / "solid" / "solid_1.vtu"
    (pieces / "plane_1.vtu").write_bytes(other.read_bytes())
    with pytest.raises(FileError, match=r"point \d+ has several places"):
        read(tmp_path / "plane.pvtu")


def test_fewer_ranks_leave_no_piece_of_more(tmp_path: Path) -> None:
    (tmp_path / "plane").mkdir()
    (tmp_path / "plane" / "plane_7.vtu").write_text("of somebody else")
    for size in (3, 2):
        on_ranks(size, write_all, str(tmp_path))
    assert {file.name for file in (tmp_path / "plane").iterdir()} == {
        "plane_0.vtu",
        "plane_1.vtu",
        "plane_7.vtu",
    }
    assert read(tmp_path / "plane.pvtu").n_cells == 90


# -- all or nothing --------------------------------------------------------------------------------------
def fails(folder: str, how: str) -> tuple[str, list[str]]:
    """Writing that fails on rank 1, or on all; the error of this rank, and what is left of the files."""
    home, ranks = Path(folder), Ranks()
    mesh, target = shared(MESHES["plane"]()), home / "plane.pvtu"
    kept = own_pieces.write_document
    if how == "full" and ranks.rank == 1:
        import resource

        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (2000, resource.RLIM_INFINITY))
    if how == "stopped" and ranks.rank == 1:

        def stopped(*_: object, **__: object) -> None:
            raise KeyboardInterrupt

        own_pieces.write_document = stopped  # type: ignore[assignment]
    if how == "no folder":
        target = home / "nowhere" / "plane.pvtu"
    if how == "suffix":
        target = home / "plane.vtu"
    error = ""
    try:
        write(target, mesh)
    except BaseException as raised:
        error = f"{type(raised).__name__}: {raised}".replace(folder, "")
    own_pieces.write_document = kept
    ranks.gathered(0)
    return error, sorted(str(file.relative_to(home)) for file in home.rglob("*"))


@pytest.mark.skipif(os.name != "posix", reason="limits of file sizes are POSIX")
@pytest.mark.parametrize("before", [False, True])
@pytest.mark.parametrize(
    ("how", "errors"),
    [
        ("full", ["RankError: rank 1: FileError: plane/plane_1.vtu: File too large", "FileError: plane/pl"]),
        ("stopped", ["RankError: rank 1: KeyboardInterrupt: ", "KeyboardInterrupt: "]),
        ("no folder", ["FileError: /nowhere/plane.pvtu: the folder /nowhere does not exist"] * 2),
        ("suffix", ["OptionError: /plane.vtu: what lies on several ranks is written as .pvtu"] * 2),
    ],
)
def test_what_fails_on_one_rank_leaves_nothing(
    tmp_path: Path, how: str, errors: list[str], before: bool
) -> None:
    """Not a file more than before; what was there stays as it was."""
    kept = []
    if before:
        (tmp_path / "plane").mkdir()
        kept = ["plane", "plane.pvtu", "plane/plane_0.vtu"]
        for name in kept[1:]:
            (tmp_path / name).write_text("earlier")
    answers = on_ranks(2, fails, str(tmp_path), how, seconds=20.0)
    for (found, left), expected in zip(answers, errors, strict=True):
        assert found.startswith(expected)
        assert left == kept
    assert all((tmp_path / name).read_text() == "earlier" for name in kept[1:])


def test_numbers_of_ranks_do_not_matter_to_the_points(tmp_path: Path) -> None:
    """Two points at one place stay two: points are told apart by their ids, not by where they are."""
    crack = samples.squares(2)
    twice = Mesh.from_polygons(
        np.concatenate((crack.points, [[0.5, 0.5]])),
        [[0, 1, 4, 3], [1, 2, 5, 9], [3, 4, 7, 6], [4, 5, 8, 7]],
        merge_points=False,
        allow_gaps=True,
    )
    (tmp_path / "two").mkdir()
    on_ranks(2, write_given, str(tmp_path / "two" / "m.pvtu"), twice)
    again = read(tmp_path / "two" / "m.pvtu", merge_points=False, allow_gaps=True)
    assert (again.n_points, again.n_faces) == (twice.n_points, twice.n_faces)
    assert all(one <= other for one, other in pairwise(np.sort(again.cell_measures)))


def write_given(path: str, mesh: Mesh) -> None:
    write(path, shared(mesh))
