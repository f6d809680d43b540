"""The command line as tests call it; the fixture ``agglo`` in conftest.py."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import pytest

from agglo_core.cli import main

__all__ = ["Agglo", "Done", "caller"]


class Done(NamedTuple):
    """Exit code, and what was printed."""

    code: int
    out: str
    err: str


Agglo = Callable[..., Done]


def caller(capsys: pytest.CaptureFixture[str]) -> Agglo:
    """Function that runs ``agglo`` with its arguments in this process."""

    def call(*arguments: str) -> Done:
        capsys.readouterr()
        with pytest.raises(SystemExit) as done:
            main(arguments)
        assert isinstance(done.value.code, int)
        return Done(done.value.code, *capsys.readouterr())

    return call
