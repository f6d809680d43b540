"""Files that appear whole or not at all: after kills, beside live writers, on full and read-only disks."""

from __future__ import annotations

import errno
import fcntl
import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import agglo_core as agglo
from agglo_core import FileError, Mesh, samples
from agglo_core.hierarchy import Hierarchy
from agglo_core.io import check_writable
from agglo_core.io.atomic import staging

WRITER = """
import sys, time
from pathlib import Path
from agglo_core.io import check_writable
from agglo_core.io.atomic import staging
target = Path(sys.argv[1])
with staging(target) as folder:
    (folder / target.name).write_text("theirs")
    (folder / "more.txt").write_text("theirs")
    print("writing", flush=True)
    sys.stdin.read()
"""


@contextmanager
def writing(target: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process in the middle of writing two files; it goes on when its input ends."""
    command = [sys.executable, "-c", WRITER, str(target)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "writing\n"
            yield process
        finally:
            process.kill()


def put(target: Path, text: str = "ours") -> None:
    with staging(target) as folder:
        (folder / target.name).write_text(text)


def hidden(folder: Path) -> list[str]:
    return sorted(name for name in os.listdir(folder) if name.startswith("."))


def test_what_a_killed_run_left_is_removed_by_the_next_write(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    target = tmp_path / "größe 1.vtu"
    with writing(target) as process:
        process.kill()
        process.wait()
        (left,) = hidden(tmp_path)
        assert left.startswith(".größe 1.vtu.agglo-")
        assert len(os.listdir(tmp_path / left)) == 2
        put(tmp_path / "other.vtu")
        assert hidden(tmp_path) == [left]  # it may be of use to whoever wrote größe 1.vtu
        with caplog.at_level("INFO", "agglo"):
            agglo.write(target, samples.squares(2))
    assert sorted(os.listdir(tmp_path)) == sorted([target.name, "other.vtu"])
    assert f"removed {tmp_path / left}" in caplog.text
    assert agglo.read(target).n_cells == 4


def test_a_live_writer_keeps_its_files(tmp_path: Path) -> None:
    target = tmp_path / "a.vtu"
    with writing(target) as process:
        (theirs,) = hidden(tmp_path)
        os.utime(tmp_path / theirs, (0, 0))  # however old
        put(target)
        assert target.read_text() == "ours"
        assert hidden(tmp_path) == [theirs]
        process.communicate()
        assert process.returncode == 0
    assert target.read_text() == "theirs"
    assert sorted(os.listdir(tmp_path)) == ["a.vtu", "more.txt"]


def test_writers_in_one_process_know_each_other(tmp_path: Path) -> None:
    target = tmp_path / "a.vtu"
    with staging(target) as folder:
        (folder / "a.vtu").write_text("outer")
        put(target, "inner")
        assert folder.is_dir()
        assert target.read_text() == "inner"
    assert target.read_text() == "outer"
    assert os.listdir(tmp_path) == ["a.vtu"]


def test_two_processes_may_write_the_same_file_at_once(tmp_path: Path) -> None:
    text = "\n".join(
        (
            "import sys; from pathlib import Path; from agglo_core.io.atomic import staging",
            "target = Path(sys.argv[1])",
            "for i in range(150):",
            "    with staging(target) as folder:",
            "        (folder / target.name).write_text(sys.argv[2] * 1000)",
            "    assert len(set(target.read_text())) == 1",
        )
    )
    command = [sys.executable, "-c", text, str(tmp_path / "a.vtu")]
    both = [subprocess.Popen([*command, each]) for each in "xy"]
    assert [process.wait() for process in both] == [0, 0]
    assert os.listdir(tmp_path) == ["a.vtu"]


def test_nothing_else_is_removed(tmp_path: Path) -> None:
    folders = [
        ".a.vtu.agglo-abc",  # too short
        ".a.vtu.agglo-abcdefgh.bak",
        "a.vtu.agglo-abcdefgh",
        ".a.vtu.abcdefgh",
        ".xa.vtu.agglo-abcdefgh",
        ".axvtu.agglo-abcdefgh",
    ]
    for name in folders:
        (tmp_path / name).mkdir()
        os.utime(tmp_path / name, (0, 0))
    (tmp_path / ".a.vtu.agglo-fffffff1").write_text("a file")
    (tmp_path / ".a.vtu.agglo-fffffff2").symlink_to(tmp_path / folders[0])
    before = set(os.listdir(tmp_path))
    put(tmp_path / "a.vtu")
    assert set(os.listdir(tmp_path)) == before | {"a.vtu"}


@pytest.mark.parametrize("code", [errno.ENOTSUP, errno.ENOLCK, errno.EBADF])
def test_folders_that_cannot_be_locked_are_removed_by_age(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    def refused(descriptor: int, operation: int) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(fcntl, "flock", refused)
    old, young = tmp_path / ".a.vtu.agglo-00000000", tmp_path / ".a.vtu.agglo-11111111"
    for folder, hours in ((old, 25), (young, 23)):
        folder.mkdir()
        os.utime(folder, (time.time() - 3600 * hours,) * 2)
    put(tmp_path / "a.vtu")
    assert sorted(os.listdir(tmp_path)) == [young.name, "a.vtu"]


def test_links_to_another_file_system_are_followed(tmp_path: Path) -> None:
    far = Path("/dev/shm")
    if not far.is_dir() or far.stat().st_dev == tmp_path.stat().st_dev:
        pytest.skip("there is one file system")
    real = far / f"agglo-test-{os.getpid()}.vtu"
    left = far / f".{real.name}.agglo-abcdefgh"
    try:
        left.mkdir()
        real.write_text("old")
        real.chmod(0o640)
        (tmp_path / "a.vtu").symlink_to(real)
        put(tmp_path / "a.vtu")
        assert (tmp_path / "a.vtu").is_symlink()
        assert real.read_text() == "ours"
        assert real.stat().st_mode & 0o777 == 0o640
        assert [path for path in far.iterdir() if real.name in path.name] == [real]
        assert os.listdir(tmp_path) == ["a.vtu"]
    finally:
        real.unlink(missing_ok=True)


@pytest.mark.parametrize("name", ["ü" * 125 + ".vtu", "x" * 251 + ".vtu", " a  b .vtu", "日本\n語.vtu"])
def test_unusual_file_names_are_written_and_read(tmp_path: Path, name: str) -> None:
    for _ in range(2):
        agglo.write(tmp_path / name, samples.squares(2))
        assert agglo.read(tmp_path / name).n_cells == 4
        assert os.listdir(tmp_path) == [name]


def halves() -> tuple[Mesh, Hierarchy]:
    mesh = samples.squares(30)
    return mesh, Hierarchy(mesh, mesh.graph, [np.repeat([0, 1], 450)], [{"parts": 2}], nested=True)


def test_a_name_too_long_for_the_levels_writes_nothing(tmp_path: Path) -> None:
    target = tmp_path / ("x" * 250 + ".vtu")
    with pytest.raises(FileError, match=r"xx\.vtu: File name too long"):
        agglo.write(target, *halves())
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("suffix", [".vtu", ".npz"])
def test_a_full_disk_leaves_the_old_files(tmp_path: Path, suffix: str) -> None:
    """The system itself refuses to write more than 2 kB into a file."""
    target = tmp_path / f"a{suffix}"
    agglo.write(target, samples.squares(2))
    old = target.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2048, limits[1]))
    try:
        with pytest.raises(FileError) as caught:
            agglo.write(target, *halves())
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert str(caught.value) == f"{target}: File too large"
    assert target.read_bytes() == old
    assert os.listdir(tmp_path) == [target.name]


def test_a_full_disk_leaves_no_folders(tmp_path: Path) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (300, limits[1]))
    try:
        with pytest.raises(FileError, match=r"out\.foam: File too large"):
            agglo.write(tmp_path / "out.foam", samples.boxes(3))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert os.listdir(tmp_path) == []


@contextmanager
def unprivileged() -> Iterator[None]:
    """As a user who may not write everywhere."""
    if os.geteuid() != 0:
        yield
        return
    os.setresuid(65534, 65534, 0)
    try:
        yield
    finally:
        os.setresuid(0, 0, 0)


def test_a_folder_that_is_read_only_is_named(tmp_path: Path) -> None:
    agglo.write(tmp_path / "first.vtu", samples.squares(2))  # modules are imported, kernels compiled
    before = [(folder, folder.stat().st_mode) for folder in (tmp_path, *tmp_path.parents[:-1])]
    try:
        for folder, mode in before:
            folder.chmod(mode | 0o055)
        tmp_path.chmod(0o555)
        with unprivileged(), pytest.raises(FileError) as caught:
            agglo.write(tmp_path / "a.vtu", samples.squares(2))
    finally:
        for folder, mode in before:
            folder.chmod(mode)
    assert str(caught.value) == f"{tmp_path / 'a.vtu'}: the folder is not writable"
    assert os.listdir(tmp_path) == ["first.vtu"]


def test_links_that_lead_nowhere(tmp_path: Path) -> None:
    for link, to in {"a.npz": "b.npz", "b.npz": "a.npz", "c.npz": "no/x.npz", "d.vtu": "e.vtu"}.items():
        (tmp_path / link).symlink_to(to)
    mesh = samples.squares(2)
    with pytest.raises(FileError, match=r"a\.npz: is a symbolic link that leads back to itself"):
        agglo.write(tmp_path / "a.npz", mesh)
    with pytest.raises(FileError, match=r"b\.npz: is a symbolic link that leads back to itself"):
        check_writable(tmp_path / "b.npz")
    with pytest.raises(FileError, match=r"c\.npz: is a symbolic link to .*/no/x\.npz, whose folder does not"):
        agglo.write(tmp_path / "c.npz", mesh)
    with pytest.raises(FileError, match=r"a\.npz: no such file"):
        agglo.read(tmp_path / "a.npz")
    agglo.write(tmp_path / "d.vtu", mesh)  # the file need not be there yet
    assert (tmp_path / "d.vtu").is_symlink()
    assert agglo.read(tmp_path / "e.vtu").n_cells == 4
    assert sorted(os.listdir(tmp_path)) == ["a.npz", "b.npz", "c.npz", "d.vtu", "e.vtu"]


IN_ANY_LOCALE = """
import os, sys
import agglo_core as agglo
mesh = agglo.samples.boxes(2)
for name in sys.argv[1:]:
    for suffix in (".npz", ".vtu", ".ele", ".hedra", ".foam"):
        agglo.write(name + suffix, mesh)
        back = agglo.read(name + suffix)
        agglo.write("back" + suffix, back)
        print(ascii(back.name), back.n_cells)
try:
    agglo.write("\\u0142.npz", mesh)
except agglo.FileError as error:
    print(error)
"""
ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


@pytest.mark.slow
@pytest.mark.parametrize("locale", [ASCII, {}], ids=["ascii", "utf-8"])
def test_names_that_the_locale_cannot_decode(tmp_path: Path, locale: dict[str, str]) -> None:
    shown_as = {"ł".encode(): r"'\u0142'", b"\xe9": r"'\ufffd'"}
    command = [sys.executable, "-c", IN_ANY_LOCALE, *shown_as]
    done = subprocess.run(
        command, cwd=tmp_path, env={**os.environ, **locale}, capture_output=True, check=False
    )
    lines = done.stdout.decode("utf-8").splitlines()
    assert done.stderr == b""
    for first, shown in zip((0, 5), shown_as.values(), strict=True):
        assert lines[first + 1 : first + 5] == [f"{shown} 8"] * 4
    assert lines[10:] == (
        [r"'\u0142.npz': the name has characters outside ascii, the encoding of file names"] if locale else []
    )
    files = os.listdir(os.fsencode(tmp_path))
    suffixes = (b".npz", b".vtu", b".ele", b".node", b".hedra", b".foam")
    assert {name + suffix for name in shown_as for suffix in suffixes} <= set(files)
    assert not [each for each in files if b"agglo-" in each]


def test_null_characters_in_names(tmp_path: Path) -> None:
    for use in (agglo.read, lambda path: agglo.write(path, samples.squares(2)), check_writable):
        with pytest.raises(FileError, match="a file name cannot hold a null character"):
            use(f"{tmp_path}/a\0b.vtu")
