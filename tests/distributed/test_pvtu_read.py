"""Reading files on several ranks: pieces as they lie, whole files shared out."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from core.io.test_io_pvtu import listing, squares_of
from distributed.shared_meshes import MESHES
from on_ranks import on_ranks

from agglo_core import Mesh, samples, write as write_whole
from agglo_core.distributed import DistributedMesh, Ranks, read as read_shared

Facts = dict[str, Any]


def facts(mesh: Mesh, cells: Any, faces: Any, ids: Any) -> Facts:
    """What does not depend on how points and faces are numbered."""
    return {
        "ids": ids.tolist(),
        "centroids": np.round(mesh.cell_centroids[cells], 12).tolist(),
        "measures": np.round(mesh.cell_measures[cells], 12).tolist(),
        "tags": {name: tag[cells].tolist() for name, tag in mesh.cell_tags.items()},
        "outer": int((mesh.face_cells[faces, 1] < 0).sum()),
        "faces": {name: sorted(tag[faces].tolist()) for name, tag in mesh.face_tags.items()},
    }


def own_facts(mesh: DistributedMesh) -> Facts:
    """Of own cells, and of faces whose owner is one."""
    mesh.check()
    owner = mesh.owners[mesh.local.face_cells[:, 0]]
    return facts(mesh.local, mesh.own, np.flatnonzero(owner == mesh.ranks.rank), mesh.global_ids[mesh.own])


def read_all(folder: str, suffix: str) -> dict[str, Facts]:
    ranks = Ranks()
    return {
        name: own_facts(read_shared(Path(folder) / f"{name}{suffix}", ranks, allow_gaps=name == "crack"))
        for name in MESHES
    }


def check_all(answers: list[dict[str, Facts]]) -> None:
    """Each cell and each face on one rank, as in the mesh that was written."""
    for name, make in MESHES.items():
        mesh, owned = make(), [each[name] for each in answers]
        whole = facts(mesh, np.arange(mesh.n_cells), np.arange(mesh.n_faces), np.arange(mesh.n_cells))
        ids = [cell for each in owned for cell in each["ids"]]
        assert sorted(ids) == whole["ids"]
        for key in ("centroids", "measures"):
            found = [value for each in owned for value in each[key]]
            np.testing.assert_allclose(found, np.array(whole[key])[ids], rtol=0.0, atol=1e-11)
        for tag, values in whole["tags"].items():
            assert [value for each in owned for value in each["tags"][tag]] == np.array(values)[ids].tolist()
        assert sum(each["outer"] for each in owned) == whole["outer"]
        for tag, values in whole["faces"].items():
            assert sorted(value for each in owned for value in each["faces"][tag]) == values


def test_fewer_ranks_than_pieces_read_the_mesh(by_three: Path) -> None:
    check_all(on_ranks(2, read_all, str(by_three), ".pvtu"))


@pytest.mark.slow
@pytest.mark.parametrize("size", [1, 3, 5])
def test_any_number_of_ranks_reads_the_mesh(by_three: Path, size: int) -> None:
    check_all(on_ranks(size, read_all, str(by_three), ".pvtu"))


# -- files of others, broken files, whole files -----------------------------------------------------------
def read_others(folder: str) -> list[str | Facts]:
    """What rank 0 and others get of each file: facts or an error."""
    ranks, answers = Ranks(), []
    for name in OTHERS:
        try:
            answers.append(own_facts(read_shared(Path(folder) / name, ranks)))
        except Exception as error:
            answers.append(f"{type(error).__name__}: {error}".replace(folder, ""))
    return answers


OTHERS = [
    "all.pvtu",
    "ghosts/all.pvtu",
    "lost.pvtu",
    "broken.pvtu",
    "no.pvtu",
    "hanging.pvtu",
    "whole.vtu",
    "mixed.pvtu",
    "crack.pvtu",
]


def hanging(folder: Path) -> None:
    """A large square beside two small ones, in one piece: a point hangs on its side."""
    points = [[0, 0], [2, 0], [2, 2], [0, 2], [3, 0], [3, 1], [2, 1], [3, 2]]
    mesh = Mesh.from_polygons(
        points, [[0, 1, 2, 3], [1, 4, 5, 6], [6, 5, 7, 2]], merge_points=False, allow_gaps=True
    )
    write_whole(folder / "hanging.vtu", mesh)
    (folder / "hanging.pvtu").write_text(listing("hanging.vtu"))


def test_files_of_others_and_broken_ones(by_three: Path, tmp_path: Path) -> None:
    """Without global ids points are matched by their places, and what hangs is joined; errors are told on
    every rank, also that points have ids which keep apart what lies on one another."""
    (squares_of(tmp_path) / "all.pvtu").write_text(listing("a.vtu", "b.vtu"))
    (squares_of(tmp_path / "ghosts", ghosts=True) / "all.pvtu").write_text(listing("a.vtu", "b.vtu"))
    (tmp_path / "lost.pvtu").write_text(listing("a.vtu", "lost.vtu"))
    shutil.copy(by_three / "solid" / "solid_1.vtu", tmp_path / "bad.vtu")
    (tmp_path / "mixed.pvtu").write_text(listing("a.vtu", "bad.vtu"))
    (tmp_path / "broken.pvtu").write_text(listing("a.vtu", "short.vtu"))
    (tmp_path / "short.vtu").write_bytes((tmp_path / "bad.vtu").read_bytes()[:-30])
    hanging(tmp_path)
    shutil.copytree(by_three / "crack", tmp_path / "crack")
    shutil.copy(by_three / "crack.pvtu", tmp_path)
    write_whole(tmp_path / "whole.vtu", samples.boxes(2))
    first, second = on_ranks(2, read_others, str(tmp_path))
    for place in (0, 1):
        assert [each[place]["ids"] for each in (first, second)] == [[0], [1]]
        assert [each[place]["tags"]["mat"] for each in (first, second)] == [[4], [6]]
        assert sum(each[place]["outer"] for each in (first, second)) == 6
    assert second[2] == "FileError: /lost.pvtu: piece 'lost.vtu': no such file"
    assert first[2] == f"RankError: rank 1: {second[2]}"
    assert str(second[3]).startswith("FileError: /broken.pvtu: piece 'short.vtu': truncated")
    assert first[3] == f"RankError: rank 1: {second[3]}"
    assert first[4] == "FileError: /no.pvtu: no such file"
    assert second[4] == "RankError: rank 0: FileError: /no.pvtu: no such file"
    assert sorted(first[5]["ids"] + second[5]["ids"]) == [0, 1, 2]
    assert first[5]["outer"] + second[5]["outer"] == 7
    assert sorted(first[6]["ids"] + second[6]["ids"]) == list(range(8))
    assert first[7] == second[7] == "MeshError: /mixed.pvtu: some of its pieces are 2-D, others 3-D"
    assert all("coincide" in str(each[8]) for each in (first, second))
