"""The command line when it is stopped: full disks, lack of memory, Ctrl-C and SIGTERM."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import click
import pytest

from agglo_core.cli import main
from agglo_core.cli.runs import attempt
from agglo_core.cli.stopping import Terminated, find_interrupt, terminations
from agglo_core.errors import OptionError, PluginError
from agglo_core.registry import Command, default as default_registry, hookimpl

Fail = Callable[[BaseException], tuple[int, str]]

PROGRAM = "from agglo_core.cli import main; main()"
STOPPED = """
import os, signal, time
from agglo_core.cli import main
from agglo_core.io.vtk import xml_write as vtu_document

def stopped(*_):
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(20)

vtu_document._xml = stopped
main()
"""


def caused(outer: BaseException, *inner: BaseException) -> BaseException:
    """``outer``, whose cause is the first of ``inner``, whose cause is the next one."""
    for error, cause in zip((outer, *inner), inner, strict=False):
        error.__cause__ = cause
    return outer


@pytest.fixture
def fail(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Iterator[Fail]:
    """Run a command that raises: exit code and stderr."""
    home = SimpleNamespace()
    monkeypatch.setitem(sys.modules, "failing", home)
    commands = [Command("fail", "failing:fail", "Fails.")]
    default_registry().register(SimpleNamespace(agglo_commands=hookimpl(lambda: commands)), "failing")

    def run(error: BaseException) -> tuple[int, str]:
        @click.command()
        def command() -> None:
            raise error

        home.fail = command
        with pytest.raises(SystemExit) as done:
            main(["fail"])
        assert isinstance(done.value.code, int)
        return done.value.code, capsys.readouterr().err.strip()

    yield run
    default_registry().unregister("failing")


def start(folder: Path, program: str, *arguments: str, stdout: int) -> tuple[int, str]:
    done = subprocess.run(
        [sys.executable, "-c", program, *arguments],
        cwd=folder,
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        timeout=60,
        check=False,
    )
    return done.returncode, done.stderr


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full")
@pytest.mark.parametrize("arguments", [["plugins"], ["plugins", "--json"], ["--help"]])
def test_a_full_disk_behind_stdout_is_one_line(tmp_path: Path, arguments: list[str]) -> None:
    with open("/dev/full", "w") as full:
        code, err = start(tmp_path, PROGRAM, *arguments, stdout=full.fileno())
    assert (code, err) == (2, "error: the output cannot be written: No space left on device\n")


def test_lack_of_memory_is_one_line(fail: Fail) -> None:
    assert fail(MemoryError()) == (2, "error: out of memory")
    assert fail(MemoryError("Unable to allocate 7 TiB")) == (
        2,
        "error: out of memory: Unable to allocate 7 TiB",
    )


def test_system_errors_of_other_kinds_are_bugs(fail: Fail) -> None:
    with pytest.raises(OSError, match="strange"):
        fail(OSError("strange"))
    with pytest.raises(SystemError):
        fail(SystemError("strange"))


def test_interrupts_are_found_behind_other_errors(fail: Fail) -> None:
    assert fail(KeyboardInterrupt()) == (130, "interrupted")
    assert fail(Terminated()) == (143, "terminated")
    for interrupt, answer in (
        (KeyboardInterrupt(), (130, "interrupted")),
        (Terminated(), (143, "terminated")),
    ):
        kernel = SystemError("returned a result with an exception set")
        assert fail(caused(kernel, interrupt)) == answer
        assert fail(caused(PluginError("kmeans raised SystemError"), kernel, interrupt)) == answer
    assert find_interrupt(caused(PluginError(), ValueError())) is None
    assert fail(caused(PluginError("it failed"), ValueError()))[0] == 2


def test_an_interrupted_run_is_no_failed_one(monkeypatch: pytest.MonkeyPatch) -> None:
    from agglo_core import samples
    from agglo_core.agglomeration import one_call

    errors: list[Exception] = [OptionError("in the warm-up"), OptionError("plain")]

    def agglomerate(*_: object, **__: object) -> None:
        raise errors.pop(0)

    monkeypatch.setattr(one_call, "agglomerate", agglomerate)
    assert attempt(samples.squares(2), "mine", {}).error == "plain"
    stop = caused(PluginError("it raised SystemError"), SystemError(), KeyboardInterrupt())
    assert isinstance(stop, PluginError)
    errors[:] = [stop, OptionError("never reached")]
    with pytest.raises(PluginError, match="SystemError"):
        attempt(samples.squares(2), "mine", {})
    errors[:] = [OptionError("in the warm-up"), stop]
    with pytest.raises(PluginError, match="SystemError"):
        attempt(samples.squares(2), "mine", {})


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_sigterm_during_a_write_leaves_nothing(tmp_path: Path) -> None:
    code, err = start(tmp_path, STOPPED, "mesh", "squares:n=2", "-o", "o.vtu", stdout=subprocess.DEVNULL)
    assert code == 143
    assert err.split()[-1] == "terminated"
    assert "Traceback" not in err
    assert os.listdir(tmp_path) == []


def test_sigterm_is_handled_only_without_another_handler() -> None:
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    with pytest.raises(Terminated), terminations():
        signal.raise_signal(signal.SIGTERM)
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    try:
        with terminations():
            signal.raise_signal(signal.SIGTERM)
            assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def test_errors_that_go_back_to_one_another_are_no_interrupt() -> None:
    first, second = ValueError("first"), ValueError("second")
    first.__cause__, second.__context__ = second, first
    assert find_interrupt(first) is None
    second.__context__ = KeyboardInterrupt()
    assert find_interrupt(first) is second.__context__
