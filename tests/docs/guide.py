"""Run a guide: the fenced blocks of a Markdown file, from top to bottom, in the current folder.

``python tests/docs/guide.py docs/how-to/write-a-plugin.md``; without a file it serves requests (`serve`).

- A block whose first line is a comment with a path, ``# my_package/halves.py``, is written to that file.
- ``python`` blocks are executed in one namespace; ``sh`` blocks are run by ``bash -e``.
- ``output`` must equal the output of the previous block; ``…`` matches anything, and spaces do not matter.
- A block marked ``needs:MODULE`` runs only if that module is installed.
- Other languages, and blocks marked ``no-run`` (as in ```` ```sh no-run ````), are not run.
"""

from __future__ import annotations

import doctest
import importlib
import io
import json
import os
import re
import subprocess
import sys
import tempfile
import textwrap
import traceback
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

__all__ = ["Block", "GuideError", "blocks", "run", "serve"]

_FENCE = re.compile(r"^( *)```([^`\n]*)\n(.*?)^\1``` *$", re.MULTILINE | re.DOTALL)
_PATH = re.compile(r"# ([\w./-]+\.\w+)\n")
_LOOSELY = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


class GuideError(Exception):
    """Block that fails or prints other text than the guide.

    The message begins with file and line.
    """


@dataclass(frozen=True)
class Block:
    """Fenced block: words after the fence, text, and number of its first line."""

    words: tuple[str, ...]
    text: str
    line: int

    @property
    def language(self) -> str:
        """First word after the fence, or empty if missing or if the block must not run."""
        return "" if not self.words or "no-run" in self.words or self._lacking() else self.words[0]

    def _lacking(self) -> bool:
        needed = (word.removeprefix("needs:") for word in self.words if word.startswith("needs:"))
        return any(find_spec(module) is None for module in needed)

    @property
    def path(self) -> str | None:
        """Path of the file for this block, if any."""
        found = _PATH.match(self.text)
        return found[1] if found and self.language else None


def blocks(guide: Path) -> Iterator[Block]:
    """Yield the fenced blocks of a Markdown file."""
    text = guide.read_text(encoding="utf-8")
    for fence in _FENCE.finditer(text):
        line = text.count("\n", 0, fence.start(3)) + 1
        yield Block(tuple(fence[2].split()), textwrap.dedent(fence[3]), line)


def run(guide: Path) -> None:
    """Run every block of a guide in the current folder.

    Raises
    ------
    GuideError
        If a command fails or prints other text than the guide. Exceptions of Python blocks propagate.
    """
    namespace: dict[str, Any] = {"__name__": "__main__"}
    printed = ""
    for block in blocks(guide):
        where = f"{guide.name}:{block.line}"
        if block.path is not None:
            Path(block.path).parent.mkdir(parents=True, exist_ok=True)
            Path(block.path).write_text(block.text, encoding="utf-8")
        elif block.language == "python":
            printed = _python(guide, block, namespace)
        elif block.language == "sh":
            printed = _shell(block, where)
        elif block.language == "output":
            _compare(block.text, printed, where)


def _python(guide: Path, block: Block, namespace: dict[str, Any]) -> str:
    """Execute a block so that tracebacks show the lines of the guide."""
    out = io.StringIO()
    with redirect_stdout(out):
        exec(compile("\n" * (block.line - 1) + block.text, str(guide), "exec"), namespace)
    return out.getvalue()


def _shell(block: Block, where: str) -> str:
    command = ["bash", "-eo", "pipefail", "-c", block.text]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    if done.returncode:
        raise GuideError(f"{where}: exit code {done.returncode} of\n{block.text}\n{done.stdout}")
    importlib.invalidate_caches()  # new modules may have been installed
    return re.sub(r"(?m)^note: compiling .*\n", "", done.stdout)  # on a first run


def _compare(wanted: str, printed: str, where: str) -> None:
    pattern = wanted.replace("…", "...")
    if not doctest.OutputChecker().check_output(pattern, printed, _LOOSELY):
        raise GuideError(f"{where}: the guide says\n{wanted}\nbut the block before it printed\n{printed}")


def serve() -> None:
    """Run guides in forks of this process, which imports what most guides import.

    A request is a line of JSON: the arguments of `_run_fork`. The answer is a line with the exit code.
    """
    import agglo_core as agglo

    mesh = agglo.samples.voronoi(100, seed=1)
    hierarchy = agglo.agglomerate(mesh, h_factor=(2, 4))
    if find_spec("matplotlib") is not None:
        with tempfile.TemporaryDirectory() as folder:
            agglo.plot.draw(mesh, {"": hierarchy}, Path(folder) / "levels.png")
    for line in sys.stdin:
        copy = os.fork()
        if copy == 0:
            _run_fork(**json.loads(line))
        sys.stdout.write(f"{os.waitstatus_to_exitcode(os.waitpid(copy, 0)[1])}\n")
        sys.stdout.flush()


def _run_fork(guide: str, folder: str, output: str, environment: dict[str, str]) -> None:
    """Run a guide in a folder, write its output and errors to a file, and exit."""
    code = 1
    try:
        with open(output, "wb") as file, open(os.devnull, "rb") as nothing:
            os.dup2(nothing.fileno(), 0)
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
        os.environ.update(environment)
        os.chdir(folder)
        sys.path.insert(1, environment["PIP_TARGET"])
        run(Path(guide))
        code = 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


if __name__ == "__main__":
    sys.path[0] = ""  # import from the current folder instead of this folder
    if len(sys.argv) > 1:
        run(Path(sys.argv[1]))
    else:
        serve()
