"""A small, fixed share of the damaged files that ``tests/fuzz/fuzz_files.py`` makes, and 2,000."""

from __future__ import annotations

import io
import os
import re
import subprocess
import sys
import zipfile
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import fuzz.fuzz_files as fuzzer
import numpy as np
import pytest
from fuzz.bombs import bombs
from fuzz.corpus import valid_files
from fuzz.fuzz_files import FIELD, fuzz, judge
from fuzz.memory import ALLOWED, Memory
from fuzz.several import SEVERAL, lay_out

from agglo_core import AggloError, FileError, Mesh, PluginError, read, read_hierarchy, samples, write
from agglo_core.arrays import trusted

NEWER = (".ovm", ".ply", ".vtkhdf", ".grf", ".map", ".mtx", ".system.npz", ".linear.toml")
NEWER = [suffix for suffix in NEWER if suffix in fuzzer.SUFFIXES]
MANY = {
    ".vtu": 650,
    ".npz": 480,
    ".msh": 100,
    ".toml": 350,
    ".problem.toml": 120,
    ".safetensors": 150,
    ".geojson": 150,
}

OTHERS = [each for each in FIELD if each not in NEWER]
SHARE = {**dict.fromkeys(OTHERS, 20), ".graph": 1400, ".xyz": 300, ".part.4": 300, ".toml": 20}
"""Files of each suffix; those of runs by .toml are fast."""


def with_slow_ones(suffixes: Iterable[str]) -> list[Any]:
    return [pytest.param(each, marks=() if each == ".toml" else pytest.mark.slow) for each in suffixes]


@pytest.mark.parametrize("suffix", with_slow_ones(SHARE))
def test_damaged_files_are_read_or_refused(suffix: str) -> None:
    """Nothing leaks, nothing hangs, and ``agglo run`` leaves all of its output or none."""
    verdicts = [verdict for _, verdict in fuzz({suffix: SHARE[suffix]}, seed=0, keep=None, every=40)]
    assert [verdict for verdict in verdicts if verdict.fault] == []
    assert "refused" in {verdict.kind for verdict in verdicts}


@pytest.mark.slow
def test_two_thousand_damaged_files_of_runs(tmp_path: Path) -> None:
    """In two processes; what they print says how many were read and refused, and in how much memory."""
    assert sum(MANY.values()) == 2000
    program = [
        sys.executable,
        fuzzer.__file__,
        "--seed",
        "1",
        "--every",
        "60",
        "--keep",
        str(tmp_path / "faults"),
    ]
    counts = [word for suffix, count in MANY.items() for word in (f"--{suffix[1:]}", str(count))]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    parts = [
        subprocess.Popen(
            [*program, *counts, "--part", f"{i}/2"], stdout=subprocess.PIPE, text=True, env=environment
        )
        for i in range(2)
    ]
    said = [part.communicate()[0] for part in parts]
    print(*said, sep="\n")  # noqa: T201
    assert [part.returncode for part in parts] == [0, 0], "\n".join(said)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", NEWER)
def test_five_hundred_damaged_files(suffix: str) -> None:
    verdicts = [verdict for _, verdict in fuzz({suffix: 500}, seed=5, keep=None, every=60)]
    assert [verdict for verdict in verdicts if verdict.fault] == []


@pytest.mark.parametrize("suffix", [".vtu", ".npz", ".system.npz", ".mtx", ".safetensors", ".geojson"])
def test_bombs_cost_what_they_declare(suffix: str, tmp_path: Path) -> None:
    """Files of half a megabyte that hold 400 MB, or claim to."""
    whole = valid_files(suffix)[0]
    file = tmp_path / f"m{suffix}"
    lay_out(file, whole)
    judge(file, command=False)
    memory = Memory()
    for content in bombs(suffix):
        lay_out(file, content)
        memory.watch()
        verdict = judge(file, command=False)
        assert not verdict.fault, verdict
        assert memory.growth() < ALLOWED // 2 + 10 * len(content), verdict


def test_bombs_are_called_by_name(tmp_path: Path) -> None:
    """The errors name the array, and what it declares and holds."""
    said = []
    for suffix in (".vtu", ".npz"):
        for content in bombs(suffix):
            (tmp_path / f"m{suffix}").write_bytes(content)
            with pytest.raises(FileError) as caught:
                read(tmp_path / f"m{suffix}")
            said.append(str(caught.value))
    text = "\n".join(said)
    assert "array 'Points': it holds 50331648 values (402653184 bytes), but the file declares 18" in text
    assert "array 'mat': a block holds more than 16 bytes, but its header declares 16" in text
    assert "array 'level_0' has shape (100663296,), but the other arrays require (9)" in text
    assert "array 'meta' has 402653184 bytes, expected at most" in text
    assert "document type declaration" in text


@pytest.mark.parametrize("suffix", with_slow_ones({**SHARE, **MANY, **dict.fromkeys(NEWER)}))
def test_what_is_damaged_was_whole(suffix: str, tmp_path: Path) -> None:
    for content in valid_files(suffix):
        file = tmp_path / f"m{suffix}"
        lay_out(file, content)
        kind = (
            "refused" if suffix == ".problem.toml" and b'"A.mtx"' in content else "read"
        )  # that matrix is not there
        assert judge(file, command=False).kind == kind


def _unnoticed(suffix: str, content: bytes, stop: int) -> bool:
    """Return True at places where a format does not declare what follows (their docstrings say so)."""
    rest = content[stop:]
    match suffix:
        case ".typ1":
            return rest[:1].isalpha()
        case ".typ2" | ".hedra":
            return rest.startswith(b"cell data: ")
        case ".obj":
            return content[stop - 1 : stop] == b"\n" and not content.startswith(b"# agglo")
        case ".mat":
            return rest[:4] in (b"\x0e\0\0\0", b"\x0f\0\0\0") and b"agglo_names" not in content
        case ".msh":
            return rest.lstrip(b"\n").startswith(b"$ElementData") and b"$Comments" not in content
        case ".vtk":
            return re.match(rb"\n?[A-Z_]{5}", rest) is not None
    return False


def _state(file: Path) -> tuple[object, ...]:
    """Return what a reader makes of a file: mesh, tags and levels."""
    mesh, hierarchy = read_hierarchy(file)
    tags = ({name: tag.tolist() for name, tag in part.items()} for part in (mesh.cell_tags, mesh.face_tags))
    return mesh.fingerprint, *tags, [level.tolist() for level in hierarchy.levels] if hierarchy else None


def _check_cuts(suffix: str, step: int, folder: Path) -> None:
    """Cut every file after each ``step``-th byte and after each line of its last kilobyte, and elsewhere."""
    file = folder / f"m{suffix}"
    for i, content in enumerate(valid_files(suffix)):
        if (suffix == ".msh" and content[:1] != b"$") or b"DATASET STRUCTURED" in content:
            continue  # read by meshlane
        lay_out(file, content)
        whole = _state(file)
        members = {file.name: content}
        if suffix in SEVERAL:
            with zipfile.ZipFile(io.BytesIO(content)) as archive:
                members = {name: archive.read(name) for name in archive.namelist()}
        for name, data in members.items():
            n, ends = len(data), np.flatnonzero(np.frombuffer(data, np.uint8) == ord("\n")) + 1
            last = max(n - 1024, 0)
            stops = {*range(last + i % step, n, step), *ends[ends >= last].tolist()}
            stops |= set(np.linspace(0, last, 4 + 36 // step, dtype=int).tolist())
            head = 120 if suffix in (".msh", ".vtk") else 0  # meshlane reads what is not recognised
            for stop in sorted(each for each in stops if head <= each < n):
                (folder / name).write_bytes(data[:stop])
                with suppress(AggloError):
                    assert _state(file) == whole or _unnoticed(suffix, data, stop), (i, name, n - stop)
            (folder / name).write_bytes(data)


@pytest.mark.parametrize("suffix", [".vtu", ".npz", ".msh", *FIELD])
def test_a_truncated_file_is_refused_or_whole(suffix: str, tmp_path: Path) -> None:
    _check_cuts(suffix, 97, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".vtu", ".npz", ".msh", *FIELD])
def test_a_file_truncated_at_any_byte_is_refused_or_whole(suffix: str, tmp_path: Path) -> None:
    _check_cuts(suffix, 1, tmp_path)


def test_the_fuzzer_sees_faults(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader that leaks, hangs or hides the file's name, a command that leaves half its output."""

    def spin(_: Path) -> None:
        while True:
            pass

    def leak(_: Path) -> None:
        raise KeyError("x")

    def blame(file: Path) -> None:
        raise PluginError(f"{file}: format 'npz' raised KeyError: 'x'")

    def nameless(_: Path) -> None:
        raise FileError("it is broken")

    file = tmp_path / "m.npz"
    write(file, samples.squares(3))
    monkeypatch.setattr(fuzzer, "SECONDS", 1)
    for reader, kind in ((spin, "hang"), (leak, "leak"), (blame, "leak"), (nameless, "nameless")):
        monkeypatch.setattr(fuzzer, "read_hierarchy", reader)
        assert judge(file, command=False).kind == kind

    def half(arguments: list[str]) -> tuple[int, str]:
        Path(arguments[-1]).write_text("half")
        return 2, "error: no"

    monkeypatch.setattr(fuzzer, "read_hierarchy", lambda _: None)
    monkeypatch.setattr(fuzzer, "_here", half)
    assert judge(file, command=False).kind == "partial output"
    monkeypatch.setattr(fuzzer, "_here", lambda _: (1, "Traceback (most recent call last):"))
    assert judge(file, command=False).kind == "command leaks"


@pytest.mark.parametrize("kind", ["squares", "boxes"])
def test_arrays_that_are_no_mesh_are_refused(kind: str, tmp_path: Path) -> None:
    """Indices within range and a true fingerprint do not make the faces of a cell close."""
    mesh = samples.from_spec(f"{kind}:n=3")
    faces, offsets = mesh.face_vertices.copy(), mesh.face_offsets
    faces[:2] = faces[:2][::-1] if kind == "squares" else (faces[0], 21)
    torn = trusted(Mesh, mesh.points, offsets, faces, mesh.face_cells)
    mirrored = mesh.points * np.where(np.arange(mesh.dim) == 0, -1, 1)
    inside_out = trusted(Mesh, mirrored, offsets, mesh.face_vertices, mesh.face_cells)
    same = mesh.face_cells.copy()
    same[np.argmax(same[:, 1] >= 0)] = 0
    for bad, message in (
        (torn, "do not close"),
        (inside_out, "inside out"),
        (trusted(Mesh, mesh.points, offsets, mesh.face_vertices, same), "on both sides"),
    ):
        write(tmp_path / "bad.npz", bad)
        with pytest.raises(FileError, match=message):
            read(tmp_path / "bad.npz")
    write(tmp_path / "good.npz", mesh.coarsen(np.arange(mesh.n_cells) % 2))
    assert read(tmp_path / "good.npz").n_cells == 2
