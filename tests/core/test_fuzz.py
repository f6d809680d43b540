"""A small, fixed share of the damaged files that ``tests/fuzz/fuzz_files.py`` makes without end."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fuzz.corpus import valid_files
from fuzz.fuzz_files import fuzz, judge

from agglo_core import FileError, Mesh, PluginError, read, samples, write


@pytest.mark.parametrize(("suffix", "count"), [(".vtu", 80), (".npz", 60), (".msh", 10)])
def test_damaged_files_are_read_or_refused(suffix: str, count: int) -> None:
    """Nothing leaks, nothing hangs, and ``agglo run`` leaves all of its output or none."""
    verdicts = [verdict for _, verdict in fuzz({suffix: count}, seed=0, keep=None, every=40)]
    assert [verdict for verdict in verdicts if verdict.fault] == []
    assert "refused" in {verdict.kind for verdict in verdicts}


@pytest.mark.parametrize("suffix", [".vtu", ".npz"])
def test_what_is_damaged_was_whole(suffix: str, tmp_path: Path) -> None:
    for content in valid_files()[suffix]:
        file = tmp_path / f"whole{suffix}"
        file.write_bytes(content)
        assert judge(file, command=False).kind == "mesh"


def test_the_fuzzer_sees_faults(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader that leaks, hangs or hides the file's name, a command that leaves half its output."""
    import fuzz.fuzz_files as fuzzer

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
    torn = Mesh(mesh.points, offsets, faces, mesh.face_cells)
    inside_out = Mesh(mesh.points * np.where(np.arange(mesh.dim) == 0, -1, 1), offsets, mesh.face_vertices,
                      mesh.face_cells)  # fmt: skip
    same = mesh.face_cells.copy()
    same[np.argmax(same[:, 1] >= 0)] = 0
    for bad, message in (
        (torn, "do not close"),
        (inside_out, "inside out"),
        (Mesh(mesh.points, offsets, mesh.face_vertices, same), "on both sides"),
    ):
        write(tmp_path / "bad.npz", bad)
        with pytest.raises(FileError, match=message):
            read(tmp_path / "bad.npz")
    write(tmp_path / "good.npz", mesh.coarsen(np.arange(mesh.n_cells) % 2))
    assert read(tmp_path / "good.npz").n_cells == 2
