"""Distributed meshes as .pvtu: what ranks write, one process reads again as it was; all of it or nothing."""

from __future__ import annotations

import os
import shutil
import signal
from pathlib import Path
from xml.etree import ElementTree

import pytest
from distributed.shared_meshes import MESHES, shared, write_all
from on_ranks import on_ranks

import agglo_core.distributed.files.own_pieces as own_pieces
from agglo_core import FileError, read, write as write_whole
from agglo_core.distributed import Ranks, write


def check_all(folder: Path, size: int, other: Path) -> None:
    """Read as one process reads what it has written itself; no piece more or less than ranks."""
    for name, make in MESHES.items():
        mesh, options = make(), {"merge_points": False, "allow_gaps": True} if name == "crack" else {}
        again = read(folder / f"{name}.pvtu", **options)
        write_whole(other / f"{name}.vtu", mesh)
        assert again.fingerprint == read(other / f"{name}.vtu", **options).fingerprint
        assert (again.n_cells, again.n_faces, again.n_points) == (mesh.n_cells, mesh.n_faces, mesh.n_points)
        assert not again.repairs
        found = {key: tag.tolist() for key, tag in again.cell_tags.items()}
        assert found == {key: tag.tolist() for key, tag in mesh.cell_tags.items()}
        pieces = sorted(file.name for file in (folder / name).iterdir())
        assert pieces == [f"{name}_{rank}.vtu" for rank in range(size)]


def test_what_ranks_write_is_read_as_what_one_process_writes(by_three: Path, tmp_path: Path) -> None:
    check_all(by_three, 3, tmp_path)


@pytest.mark.slow
def test_any_number_of_ranks_writes_it_in_the_place_of_others(by_three: Path, tmp_path: Path) -> None:
    folder = tmp_path / "pieces"
    shutil.copytree(by_three, folder)
    for size in (6, 2, 1):
        on_ranks(size, write_all, str(folder))
        check_all(folder, size, tmp_path)
    (folder / "plane" / "plane_9.vtu").write_text("of somebody else")
    on_ranks(2, write_all, str(folder))
    assert (folder / "plane" / "plane_9.vtu").read_text() == "of somebody else"
    assert len(list((folder / "plane").iterdir())) == 3


def test_the_list_declares_what_every_piece_has(by_three: Path) -> None:
    """Names, types and widths of arrays, also where only one rank has a large number or a hole."""
    for name in MESHES:
        root = ElementTree.fromstring((by_three / f"{name}.pvtu").read_bytes())
        for section in ("PointData", "CellData"):
            declared = [
                (each.get("Name"), each.get("type"))
                for each in root.iterfind(f"PUnstructuredGrid/P{section}/PDataArray")
            ]
            assert declared[-1] == (f"Global{section.removesuffix('Data')}Ids", "Int64")
            for piece in (by_three / name).iterdir():
                text = piece.read_bytes().partition(b"<AppendedData")[0] + b"</VTKFile>"
                found = ElementTree.fromstring(text).iterfind(f"UnstructuredGrid/Piece/{section}/DataArray")
                assert [(each.get("Name"), each.get("type")) for each in found] == declared


def test_vtk_reads_the_pieces_with_their_global_ids(by_three: Path) -> None:
    pyvista = pytest.importorskip("pyvista")
    grid, mesh = pyvista.read(by_three / "plane.pvtu"), MESHES["plane"]()
    ids = [int(grid.GetCellData().GetGlobalIds().GetTuple1(i)) for i in range(mesh.n_cells)]
    assert sorted(ids) == list(range(mesh.n_cells))
    assert grid.GetPointData().GetGlobalIds() is not None
    assert grid.cell_data["far"].tolist() == mesh.cell_tags["far"][ids].tolist()


def test_ids_that_contradict_one_another_are_refused(by_three: Path, tmp_path: Path) -> None:
    for name in ("plane.pvtu", "plane", "solid"):
        (shutil.copytree if (by_three / name).is_dir() else shutil.copy)(by_three / name, tmp_path / name)
    first, second = (tmp_path / "plane" / f"plane_{rank}.vtu" for rank in (0, 1))
    shutil.copy(second, first)
    with pytest.raises(FileError, match=r"cell \d+ is in several pieces"):
        read(tmp_path / "plane.pvtu")
    shutil.copy(tmp_path / "solid" / "solid_1.vtu", first)
    with pytest.raises(FileError, match=r"point \d+ has several positions"):
        read(tmp_path / "plane.pvtu")


# -- all or nothing --------------------------------------------------------------------------------------
FAULTS = {
    "full": ["RankError: rank 1: FileError: plane/plane_1.vtu: File too large", "FileError: plane/plane_1"],
    "stopped": ["RankError: rank 1: KeyboardInterrupt: ", "KeyboardInterrupt: "],
    "no folder": ["FileError: /nowhere/plane.pvtu: the folder /nowhere does not exist"] * 2,
    "suffix": ["OptionError: /plane.vtu: distributed meshes and solutions are written as .pvtu"] * 2,
    "a folder": ["FileError: /plane.pvtu is a folder", "FileError: /plane.pvtu is a folder"],
    "in the way": ["FileError: /plane.pvtu: /plane: exists and is not a folder", "RankError: rank 0: FileE"],
}
"""How writing fails on rank 1 of two, or on both, and how the errors begin."""


def fails(folder: str) -> list[tuple[str, list[str], bool]]:
    """The error of each fault on this rank, what is left of the files, and whether it is as it was."""
    ranks, mesh, answers = Ranks(), shared(MESHES["plane"]()), []
    for how in FAULTS:
        home = Path(folder) / how
        target = home / {"no folder": "nowhere/plane.pvtu", "suffix": "plane.vtu"}.get(how, "plane.pvtu")
        undo = _made_faulty(how) if ranks.rank == 1 else None
        error = ""
        try:
            write(target, mesh)
        except BaseException as raised:
            error = f"{type(raised).__name__}: {raised}".replace(str(home), "")
        if undo is not None:
            undo()
        ranks.gathered(0)
        files = [file for file in sorted(home.rglob("*")) if file.is_file()]
        same = all(file.read_text() == "earlier" for file in files)
        answers.append((error, [str(file.relative_to(home)) for file in sorted(home.rglob("*"))], same))
        ranks.gathered(0)
    return answers


def _made_faulty(how: str):  # type: ignore[no-untyped-def]
    """Make this rank fail; what undoes it."""
    if how == "full":
        import resource

        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (2000, before[1]))
        return lambda: resource.setrlimit(resource.RLIMIT_FSIZE, before)
    kept = own_pieces.write_document
    if how == "stopped":

        def stopped(*_: object, **__: object) -> None:
            raise KeyboardInterrupt

        own_pieces.write_document = stopped
    return lambda: setattr(own_pieces, "write_document", kept)


@pytest.mark.skipif(os.name != "posix", reason="limits of file sizes are POSIX")
def test_what_fails_on_one_rank_leaves_all_as_it_was(tmp_path: Path) -> None:
    """Not a file more than before, nor one less; the error is told on every rank."""
    there = {}
    for how in FAULTS:
        (tmp_path / how / "plane").mkdir(parents=True)
        files = ["plane.pvtu", "plane/plane_0.vtu", "plane/plane_5.vtu"]
        if how == "a folder":
            (tmp_path / how / "plane.pvtu").mkdir()
            files = []
        elif how == "in the way":
            (tmp_path / how / "plane").rmdir()
            files = ["plane"]
        for name in files:
            (tmp_path / how / name).write_text("earlier")
        there[how] = [str(each.relative_to(tmp_path / how)) for each in sorted((tmp_path / how).rglob("*"))]
    for rank, answers in enumerate(on_ranks(2, fails, str(tmp_path), seconds=30.0)):
        for (how, errors), (error, left, same) in zip(FAULTS.items(), answers, strict=True):
            assert error.startswith(errors[rank]), how
            assert left == there[how]
            assert same
