"""Run the command line in tests.

See the fixture ``agglo`` in conftest.py.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any, NamedTuple

import pytest

from agglo_core.cli import main

__all__ = ["Agglo", "Done", "caller"]

_COMPILING = re.compile("(?m)^note: compiling .*\n")
"""Note that only the first kernel of a process prints, if it is not on disk."""


class Done(NamedTuple):
    """Exit code and output of a command."""

    code: int
    out: str
    err: str

    @property
    def data(self) -> Any:
        """Output parsed as JSON.

        A parse error shows stderr.
        """
        try:
            return json.loads(self.out)
        except json.JSONDecodeError as error:
            error.add_note(f"exit code {self.code}, stdout {self.out!r}, stderr {self.err!r}")
            raise


Agglo = Callable[..., Done]


def caller(capsys: pytest.CaptureFixture[str]) -> Agglo:
    """Return a function that runs ``agglo`` in this process."""

    def call(*arguments: str) -> Done:
        capsys.readouterr()
        with pytest.raises(SystemExit) as done:
            main(arguments)
        assert isinstance(done.value.code, int)
        assert done.value.code != 143, "somebody sent SIGTERM to the tests, for instance a timeout"
        out, err = capsys.readouterr()
        return Done(done.value.code, out, _COMPILING.sub("", err))

    return call
