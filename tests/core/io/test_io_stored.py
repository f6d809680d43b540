"""How VTU and npz store arrays: raw or compressed, in 32 bits where they fit."""

from __future__ import annotations

import json
import re
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from vtu_by_hand import arrays_of

from agglo_core import Mesh, samples
from agglo_core.arrays import trusted_copy
from agglo_core.errors import FileError, MeshError, OptionError
from agglo_core.hierarchy import Hierarchy
from agglo_core.io import read, read_hierarchy, write
from agglo_core.io.vtk import xml_write

SQUARES = samples.squares(12)
RINGS = SQUARES.coarsen((np.abs(SQUARES.cell_centroids - 0.5).max(axis=1) * 12).astype(int))
MESHES = [samples.voronoi(300, seed=5), samples.tetrahedra(2), RINGS]


def with_hierarchy(mesh: Mesh) -> tuple[Mesh, Hierarchy]:
    cell = np.arange(mesh.n_cells)
    mesh = replace(mesh, cell_tags={"mat": cell % 7 - 3, "far": cell + 2**40})
    levels = [cell // 4, cell // 16]
    return mesh, Hierarchy(
        mesh, mesh.graph, levels, [{"parts": int(each[-1]) + 1} for each in levels], True, {}
    )


@pytest.mark.parametrize("compress", [False, True])
@pytest.mark.parametrize("suffix", [".vtu", ".npz"])
@pytest.mark.parametrize("mesh", MESHES, ids=["plane", "solid", "holes"])
def test_what_is_written_comes_back(tmp_path: Path, mesh: Mesh, suffix: str, compress: bool) -> None:
    mesh, hierarchy = with_hierarchy(mesh)
    write(tmp_path / f"m{suffix}", mesh, hierarchy, compress=compress)
    back, levels = read_hierarchy(tmp_path / f"m{suffix}")
    assert levels is not None
    assert [each.tolist() for each in levels.levels] == [each.tolist() for each in hierarchy.levels]
    assert {k: v.tolist() for k, v in back.cell_tags.items()} == {
        k: v.tolist() for k, v in mesh.cell_tags.items()
    }
    np.testing.assert_allclose(back.cell_measures, mesh.cell_measures, rtol=1e-13)
    if suffix == ".npz":
        assert back.fingerprint == mesh.fingerprint
    else:
        assert back.points.tolist() == mesh.points[np.unique(mesh.face_vertices)].tolist()


@pytest.mark.parametrize("suffix", [".vtu", ".npz"])
def test_compressed_files_are_smaller_and_say_the_same(tmp_path: Path, suffix: str) -> None:
    mesh, hierarchy = with_hierarchy(samples.squares(40))
    plain, small = tmp_path / f"plain{suffix}", tmp_path / f"small{suffix}"
    write(plain, mesh, hierarchy)
    write(small, mesh, hierarchy, compress=True)
    assert small.stat().st_size < plain.stat().st_size / 2
    if suffix == ".vtu":
        first, second = arrays_of(plain), arrays_of(small)
    else:
        first, second = (dict(np.load(file)) for file in (plain, small))
        first.pop("meta"), second.pop("meta")
    assert list(first) == list(second)
    for name, values in first.items():
        assert values.dtype == second[name].dtype
        np.testing.assert_array_equal(values, second[name])


def test_a_format_that_does_not_compress_says_so(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="compress"):
        write(tmp_path / "m.obj", samples.squares(2), compress=True)


@pytest.mark.parametrize(("value", "width"), [(2**31 - 1, 4), (-(2**31), 4), (2**31, 8), (-(2**31) - 1, 8)])
def test_integers_take_32_bits_where_they_fit(tmp_path: Path, value: int, width: int) -> None:
    mesh = replace(samples.squares(1), cell_tags={"t": [value]})
    for suffix in (".vtu", ".npz"):
        write(tmp_path / f"m{suffix}", mesh)
        assert read(tmp_path / f"m{suffix}").cell_tags["t"].tolist() == [value]
    assert arrays_of(tmp_path / "m.vtu")["t"].dtype.itemsize == width
    assert np.load(tmp_path / "m.npz")["cell_tag_0"].dtype.itemsize == width


def test_arrays_follow_one_another_without_gaps(tmp_path: Path) -> None:
    """As meshio reads raw files: offsets without padding, each where the array before it ends."""
    mesh, hierarchy = with_hierarchy(samples.boxes(3))
    write(tmp_path / "m.vtu", mesh, hierarchy)
    for file in sorted(tmp_path.iterdir()):
        content = file.read_bytes()
        start = content.index(b"_", content.index(b"<AppendedData")) + 1
        data = content[start : content.rindex(b"\n</AppendedData>")]
        place = 0
        for offset in map(int, re.findall(rb'offset="(\d+)"', content)):
            assert offset == place
            place += 8 + int.from_bytes(data[place : place + 8], "little")
        assert place == len(data)


def test_blocks_of_any_length(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Arrays of several blocks, the last one full or not; 48 bytes are two points."""
    mesh, _ = with_hierarchy(samples.squares(3))
    write(tmp_path / "whole.vtu", mesh)
    monkeypatch.setattr(xml_write, "_BLOCK", 48)
    for compress in (False, True):
        write(tmp_path / "cut.vtu", mesh, compress=compress)
        cut = arrays_of(tmp_path / "cut.vtu")
        for name, values in arrays_of(tmp_path / "whole.vtu").items():
            assert cut[name].tobytes() == values.tobytes()
        assert read(tmp_path / "cut.vtu").cell_tags["mat"].tolist() == mesh.cell_tags["mat"].tolist()


def rewritten(source: Path, target: Path, **changes: Any) -> None:
    """Copy an npz with some of its members replaced by arrays."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            array = changes.get(name.removesuffix(".npy"))
            with new.open(name, "w") as entry:
                if array is None:
                    entry.write(old.read(name))
                else:
                    np.lib.format.write_array(entry, array)


def test_what_was_altered_in_a_file_is_noticed(tmp_path: Path) -> None:
    mesh = samples.squares(4)
    write(tmp_path / "m.npz", mesh)
    points = np.array(mesh.points)
    points[-1, -1] = 0.75
    rewritten(tmp_path / "m.npz", tmp_path / "altered.npz", points=points)
    with pytest.raises(FileError, match="fingerprint"):
        read(tmp_path / "altered.npz")


@pytest.mark.parametrize("version", [1, 3])
def test_other_versions_are_refused(tmp_path: Path, version: int) -> None:
    write(tmp_path / "m.npz", samples.squares(4))
    told = json.loads(np.load(tmp_path / "m.npz")["meta"].tobytes()) | {"version": version}
    meta = np.frombuffer(json.dumps(told).encode(), np.uint8)
    rewritten(tmp_path / "m.npz", tmp_path / "other.npz", meta=meta)
    with pytest.raises(FileError, match=f"version {version} is unknown, expected 2"):
        read(tmp_path / "other.npz")


def test_faces_that_do_not_close_are_found() -> None:
    """As the slow count of how often each vertex of a cell is entered and left."""
    rng = np.random.default_rng(4)
    mesh = samples.voronoi(200, seed=2)
    for _ in range(30):
        vertices = np.array(mesh.face_vertices)
        vertices[rng.integers(len(vertices))] = rng.integers(mesh.n_points)
        wrong = trusted_copy(mesh, face_vertices=vertices)
        if (vertices == mesh.face_vertices).all():
            wrong.check()
            continue
        open_ = slow_unbalanced(wrong)
        with pytest.raises(MeshError, match=rf"^cells? {open_[0]}\b.*the faces do not close"):
            wrong.check()


def test_cells_inside_out_are_found_however_small_or_far() -> None:
    mesh = samples.voronoi(50, seed=3)
    for points in (mesh.points, 1e-9 * mesh.points + 1.0, mesh.points + 1e6):
        given = replace(mesh, points=points)
        given.check()
        turned = np.array(mesh.face_vertices).reshape(-1, 2)[:, ::-1].ravel()
        with pytest.raises(MeshError, match=r"\(50 in all\): no positive measure"):
            replace(given, face_vertices=turned)


def slow_unbalanced(mesh: Mesh) -> list[int]:
    balance = np.zeros((mesh.n_cells, mesh.n_points), int)
    for (tail, head), (owner, neighbour) in zip(mesh.face_pairs, mesh.face_cells, strict=True):
        for cell, way in ((owner, 1), (neighbour, -1)):
            if cell >= 0:
                balance[cell, tail] -= way
                balance[cell, head] += way
    return np.flatnonzero(balance.any(axis=1)).tolist()
