"""Commands that are killed, on full disks, in read-only folders, without a home folder, twenty at once."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from copied_commands import COMMANDS, Copies

pytestmark = [pytest.mark.slow, pytest.mark.skipif(sys.platform != "linux", reason="needs limits of Linux")]
TRIALS = 30
EARLIER = {
    "run": ("run", "voronoi:n=40,seed=2", "--parts", "6,3", "-o", "out.vtu"),
    "solve": ("solve", "squares:n=3", "--parts", "3", "--no-cg", "-o", "out.vtu"),
    "mesh": ("mesh", "boxes:n=2", "-o", "out.foam"),
}
"""Commands whose files those in ``COMMANDS`` replace."""


@pytest.fixture(scope="module")
def copies() -> Iterator[Copies]:
    with Copies.started() as started:
        yield started


def files_in(folder: Path) -> dict[str, bytes]:
    """The files in a folder and below it by name, without those in hidden folders."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not any(part.startswith(".") for part in path.relative_to(folder).parts[:-1])
    }


def hidden_in(folder: Path) -> list[str]:
    return [name for name in os.listdir(folder) if name.startswith(".")]


def done(copies: Copies, folder: Path, command: tuple[str, ...]) -> dict[str, bytes]:
    """Files that a command leaves which nothing hinders."""
    folder.mkdir(exist_ok=True)
    ended = copies.run(command, folder)
    assert ended.code == 0, ended.printed
    return files_in(folder)


def kills(changes: int) -> Iterator[tuple[int, float]]:
    """Changes of files at which to kill, from the first to the last, and seconds to wait then."""
    rng = np.random.default_rng(0)
    for trial in range(TRIALS):
        yield 1 + trial * changes // TRIALS, 0.0 if trial % 2 else rng.exponential(0.003)


@pytest.mark.parametrize("kind", EARLIER)
def test_a_killed_command_leaves_whole_files(copies: Copies, tmp_path: Path, kind: str) -> None:
    """Each file is as it was before or as it is to be, and nothing is in the way of the next command."""
    earlier = done(copies, tmp_path / "earlier", EARLIER[kind])
    later = done(copies, tmp_path / "later", COMMANDS[kind])
    assert earlier.keys() == later.keys()
    changes, codes = copies.run(COMMANDS[kind], tmp_path / "later").changes, []
    for kill_at, delay in kills(changes):
        work = shutil.copytree(tmp_path / "earlier", tmp_path / "work")
        codes.append(copies.run(COMMANDS[kind], work, kill_at=kill_at, delay=delay).code)
        for name, content in files_in(work).items():
            assert content in (earlier[name], later[name]), f"{name} is neither old nor new"
        if kill_at % 3 == 0:
            assert done(copies, work, COMMANDS[kind]) == later
            assert hidden_in(work) == []
        shutil.rmtree(work)
    assert set(codes) <= {-9, 0}
    assert codes.count(-9) > TRIALS // 2


def test_a_killed_training_is_resumed_to_the_same_model(copies: Copies, tmp_path: Path) -> None:
    train = COMMANDS["train"]
    whole, codes = done(copies, tmp_path / "whole", train), []
    for kill_at, delay in kills(copies.run(train, tmp_path / "whole").changes):
        (work := tmp_path / "work").mkdir()
        codes.append(copies.run(train, work, kill_at=kill_at, delay=delay).code)
        begun = (work / "checkpoint.safetensors").exists()
        ended = copies.run((*train, "--resume") if begun else train, work)
        if ended.code == 2:  # nothing was left to do but to write the model, of which resume says so
            assert "has completed 3 epochs" in ended.printed
            assert files_in(work)["checkpoint.safetensors"] == whole["checkpoint.safetensors"]
        else:
            assert ended.code == 0, ended.printed
            assert files_in(work)["out.safetensors"] == whole["out.safetensors"]
        shutil.rmtree(work)
    assert codes.count(-9) > TRIALS // 2


def test_a_killed_paper_goes_on_where_it_was(copies: Copies, tmp_path: Path) -> None:
    """Killed at thirty changes of its files, one after the other, it ends with a whole page."""
    work, codes = tmp_path / "work", []
    work.mkdir()
    for kill_at, delay in kills(8):
        codes.append(copies.run(COMMANDS["paper"], work, kill_at=kill_at, delay=delay).code)
        for name, content in files_in(work).items():
            if name.endswith(".json"):
                json.loads(content)
            elif name.endswith(".svg"):
                assert content.rstrip().endswith(b"</svg>"), name
        if codes[-1] == 0:
            shutil.rmtree(work / "out")
    found = done(copies, work, COMMANDS["paper"])
    whole = done(copies, tmp_path / "whole", COMMANDS["paper"])
    assert found.keys() == whole.keys()
    assert len(found["out/runtime.md"].splitlines()) == len(whole["out/runtime.md"].splitlines())
    assert hidden_in(work) == hidden_in(work / "out") == []
    assert codes.count(-9) > TRIALS // 2


@pytest.mark.parametrize("kind", COMMANDS)
def test_a_full_disk_ends_a_command_and_leaves_the_old_files(
    copies: Copies, tmp_path: Path, kind: str
) -> None:
    """The system refuses to write more than so many bytes into a file; six limits for each command."""
    whole = done(copies, tmp_path / "whole", COMMANDS[kind])
    for largest_file in np.geomspace(20, max(map(len, whole.values())) // 2, 6).astype(int).tolist():
        work = tmp_path / "work"
        before = done(copies, work, EARLIER[kind]) if kind in EARLIER else {}
        work.mkdir(exist_ok=True)
        ended = copies.run(COMMANDS[kind], work, largest_file=largest_file)
        assert ended.code == 2
        *_, line = ended.printed.splitlines()
        assert line.startswith(("error: out", "error: log.txt", "error: checkpoint"))
        assert line.endswith("File too large")
        for name, content in files_in(work).items():
            assert content in (before.get(name), whole.get(name)) or kind in ("train", "paper"), name
        assert "out.safetensors" not in files_in(work)
        shutil.rmtree(work)


@pytest.mark.parametrize("kind", COMMANDS)
@pytest.mark.parametrize("mode", [0o555, 0o500, 0o511, 0o544, 0o550, 0o541])
def test_a_read_only_folder_is_named_before_the_work(
    copies: Copies, tmp_path: Path, kind: str, mode: int
) -> None:
    work = tmp_path / "work"
    before = done(copies, work, EARLIER[kind]) if kind in EARLIER else {}
    work.mkdir(exist_ok=True)
    work.chmod(mode)
    try:
        ended = copies.run(COMMANDS[kind], work, privileged=False)
    finally:
        work.chmod(0o755)
    assert (ended.code, ended.changes <= 1) == (2, True)
    *_, line = ended.printed.splitlines()
    assert line.startswith(("error: out", "error: log.txt"))
    assert line.endswith(("the folder is not writable", "Permission denied"))
    assert files_in(work) == before
    assert hidden_in(work) == []


HOMES = {
    "absent": None,
    "empty": "",
    "no folder": "no/where",
    "a file": "file",
    "read-only": "read-only",
    "relative": ".",
}
WITHOUT_PRIVILEGES = """
from copied_commands import drop_privileges
from agglo_core.cli import main
drop_privileges()
main()
"""


@pytest.mark.parametrize(
    ("kind", "home"),
    [*(("run", home) for home in HOMES), *((kind, "read-only") for kind in COMMANDS if kind != "run")],
)
def test_no_command_needs_a_home_folder(tmp_path: Path, kind: str, home: str) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "read-only").mkdir(mode=0o555)
    (tmp_path / "work").mkdir()
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("HOME", "XDG_"))}
    environment |= {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "TMPDIR": str(tmp_path / "work")}
    if (value := HOMES[home]) is not None:
        environment["HOME"] = str(tmp_path / value) if value not in ("", ".") else value
    options = ("--plot", "out.png") if kind == "run" else ()  # Matplotlib keeps its fonts in the home folder
    ended = subprocess.run(
        [sys.executable, "-c", WITHOUT_PRIVILEGES, *COMMANDS[kind], *options],
        cwd=tmp_path / "work",
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    assert "Traceback" not in ended.stderr
    assert [path.name for path in (tmp_path / "read-only").iterdir()] == []
    assert any(name.startswith("out") for name in os.listdir(tmp_path / "work"))
