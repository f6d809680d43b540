"""A warm process that stands in for the new process of the law ``same_in_another_process``."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from agglo_core.conformance.base.handing_over import environment
from agglo_core.conformance.process import new_process

_SERVER = "from conformance.conftest import serve; serve()"


@pytest.fixture(scope="session")
def warm_server() -> Iterator[subprocess.Popen[str]]:
    """Start a process with another hash seed that answers each request in a fork of itself."""
    hash_seed = "2" if os.environ.get("PYTHONHASHSEED") == "1" else "1"
    command = [sys.executable, "-c", _SERVER]
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, env=environment() | {"PYTHONHASHSEED": hash_seed}, **pipes) as server:
        yield server
        assert server.stdin is not None
        server.stdin.close()


@pytest.fixture
def warm_process(warm_server: subprocess.Popen[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the law ask a fork of a warm process; a new one would import and load kernels for seconds.

    The law itself, with a new process, is tested on its mutant and by ``agglo check``.
    """

    def run(_: object, *, input: str, cwd: str | None, **__: object) -> subprocess.CompletedProcess[str]:
        (tmp_path / "in").write_text(input, encoding="utf-8")
        assert warm_server.stdin is not None
        assert warm_server.stdout is not None
        warm_server.stdin.write(json.dumps([str(tmp_path), cwd or os.getcwd()]) + "\n")
        warm_server.stdin.flush()
        code = int(warm_server.stdout.readline())
        out, err = ((tmp_path / name).read_text(encoding="utf-8") for name in ("out", "err"))
        return subprocess.CompletedProcess(_SERVER, code, out, err)

    replacement = SimpleNamespace(run=run, TimeoutExpired=subprocess.TimeoutExpired)
    monkeypatch.setattr(new_process, "subprocess", replacement)


def serve() -> None:
    """Run ``new_process.main`` in a fork for each line of stdin, and print its exit status."""
    import agglo_core.conformance.laws  # noqa: F401 (what each fork would import)

    for line in sys.stdin:
        files, folder = json.loads(line)
        child = os.fork()
        if child == 0:
            code = 1
            try:
                os.chdir(folder)
                for number, name in enumerate(("in", "out", "err")):
                    flags = os.O_RDONLY if number == 0 else os.O_WRONLY | os.O_CREAT | os.O_TRUNC
                    os.dup2(os.open(os.path.join(files, name), flags), number)
                sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115
                new_process.main()
                code = 0
            finally:
                if code:
                    sys.excepthook(*sys.exc_info())  # type: ignore[arg-type]
                sys.stderr.flush()
                os._exit(code)
        sys.stdout.write(f"{os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])}\n")
        sys.stdout.flush()
