"""Run scripts in forks of the test process, which do not import numpy and numba again."""

from __future__ import annotations

import os
import sys
import traceback
from contextlib import redirect_stderr, redirect_stdout
from functools import cache
from pathlib import Path

import numba

__all__ = ["run_in_fork"]


def run_in_fork(script: str, folder: Path, kernels: Path | None = None) -> tuple[str, str]:
    """Return what a script prints to stdout and stderr.

    Parameters
    ----------
    script : str
        Source. It may use modules of this process, and it imports others from ``folder``.
    folder : Path
        Current folder of the fork.
    kernels : Path, optional
        Folder of compiled kernels, as ``NUMBA_CACHE_DIR`` sets it. By default ``folder``.

    Raises
    ------
    AssertionError
        If the script raises.
    """
    _start_compiler()
    files = folder / "stdout", folder / "stderr"
    child = os.fork()
    if child == 0:
        code = 1
        try:
            with (
                open(files[0], "w") as out,
                open(files[1], "w") as err,
                redirect_stdout(out),
                redirect_stderr(err),
            ):
                try:
                    os.chdir(folder)
                    sys.path.insert(0, str(folder))
                    sys.dont_write_bytecode = True
                    numba.config.CACHE_DIR = str(kernels or folder)
                    exec(script, {"__name__": "__main__"})
                    code = 0
                except BaseException:
                    traceback.print_exc()
        finally:
            os._exit(code)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    out, err = (file.read_text() for file in files)
    for file in files:
        file.unlink()
    assert code == 0, err
    return out, err


@cache
def _start_compiler() -> None:
    """Let numba load its types, or each fork would."""
    numba.njit(lambda x: 2 * x)(1.5)
