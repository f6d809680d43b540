"""Command line on several MPI ranks: output, common exit code, options that are not available.

The rank count is read from launchers' environment variables, so that ordinary runs do not import
mpi4py. Rank 0 prints, and the output of other ranks is held back. At the end, the ranks exchange their exit
codes. If all ranks arrive, all exit with one code. Otherwise a failed rank prints its error after some
time, and aborts the whole run.
"""

from __future__ import annotations

import io
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable, Mapping
from contextlib import ExitStack, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any, NamedTuple

import click

from agglo_core.errors import OptionError

_LAUNCHERS = (
    ("PMI_RANK", "PMI_SIZE"),  # MPICH, Intel MPI, Cray
    ("OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE"),
    ("MV2_COMM_WORLD_RANK", "MV2_COMM_WORLD_SIZE"),
    ("SLURM_PROCID", "SLURM_STEP_NUM_TASKS"),
)
_BUG = 1  # exit code of unexpected errors
_PATIENCE = 1.0  # seconds a failed rank waits for other ranks to end
_APART = 0.2  # seconds between the timeouts of failed ranks, so that only the first reports
_LONGEST = 3.0  # maximum extra delay of a rank, seconds


class Launched(NamedTuple):
    """Rank and process count from the environment of an MPI launcher."""

    rank: int
    size: int


def find_launch(environment: Mapping[str, str] | None = None) -> Launched | None:
    """Return rank and process count if an MPI launcher started several, else None."""
    variables = os.environ if environment is None else environment
    for names in _LAUNCHERS:
        rank, size = (variables.get(name, "") for name in names)
        if rank.isdecimal() and size.isdecimal():
            return Launched(int(rank), int(size)) if int(size) > 1 else None
    return None


def refuse_on_ranks(what: str, instead: str) -> None:
    """Raise OptionError if an MPI launcher started several processes, which would all do the same work."""
    launch = find_launch()
    if launch is not None:
        raise OptionError(
            f"{what} works in one process, but {launch.size} processes were started, and "
            f"each would repeat all the work: {instead}"
        )


def refuse_files(
    files: Mapping[str, Path | None],
    instead: str = "write the mesh with -o NAME.pvtu and plot it in one process",
) -> None:
    """Raise OptionError if options request files that are not available on several MPI ranks."""
    options = [option for option, file in files.items() if file is not None]
    if options:
        raise OptionError(
            f"{' and '.join(options)} cannot be used on a mesh distributed over several processes; {instead}"
        )


def on_all_ranks(command: Callable[[], int], here: Launched) -> int:
    """Run a command on all ranks, and return an exit code equal on all of them.

    If some ranks cannot end, the whole run is aborted, including this rank.
    """
    try:
        from mpi4py import MPI
    except ImportError as error:
        if here.rank == 0:
            click.echo(
                f"error: {here.size} processes need mpi4py to work together ({error}): pip "
                "install 'agglo[mpi]'",
                err=True,
            )
        return 2
    comm = MPI.COMM_WORLD.Dup()
    stderr_buffer = io.StringIO()
    with ExitStack() as stack:
        if here.rank > 0:
            stack.enter_context(redirect_stdout(stack.enter_context(open(os.devnull, "w"))))
            stack.enter_context(redirect_stderr(stderr_buffer))
        code = _run_command(command)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interrupt must not break the exchange
    codes = _codes_of_all(comm, code)
    failed_ranks = [rank for rank, exit_code in enumerate(codes or ()) if exit_code]
    if codes is None:
        _say(stderr_buffer, f"rank {here.rank}: ")
        comm.Abort(code)
    elif failed_ranks and here.rank == (failed_ranks[0] if _BUG not in codes else codes.index(_BUG)):
        _say(stderr_buffer, f"rank {here.rank}: ")
    return codes[failed_ranks[0]] if codes is not None and failed_ranks else code


def _run_command(command: Callable[[], int]) -> int:
    try:
        return command()
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else _BUG
    except BaseException:
        traceback.print_exc()
        return _BUG


def _codes_of_all(comm: Any, code: int) -> list[int] | None:
    """Collect all ranks' exit codes.

    None if this rank has failed and other ranks do not end in time.
    """
    import numpy as np

    own_code, codes = np.array([code]), np.zeros(comm.Get_size(), np.int64)
    request = comm.Iallgather(own_code, codes)
    rank = comm.Get_rank()
    end = time.monotonic() + _PATIENCE + min(_APART * rank, _LONGEST) if code else np.inf
    while not request.Test():
        if time.monotonic() > end:
            return None
        time.sleep(0.01)
    return [int(c) for c in codes]


def _say(output: io.StringIO, rank: str) -> None:
    """Print a failed rank's buffered error messages. Rank 0 prints without a buffer."""
    lines = [line for line in output.getvalue().splitlines() if not line.startswith(("note: ", "warning: "))]
    for line in lines:
        message = line.removeprefix("error: ")
        click.echo(f"error: {rank}{message}" if message != line else line, file=sys.stderr)
