"""Every guide does what it says: its blocks are run in a folder of their own, and pip installs beside it."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from docs.guide import Block, blocks

RUNNER = Path(__file__).with_name("guide.py")
DOCS = Path(__file__).parents[2] / "docs"
GUIDES = sorted(
    [
        DOCS.parent / "README.md",
        *DOCS.glob("how-to/*.md"),
        *DOCS.glob("why/*.md"),
        *DOCS.glob("tutorial/*.md"),
        *DOCS.glob("tutorial*.md"),
    ]
)
CODES = DOCS / "how-to" / "from-and-to-your-code.md"
PLUGIN = DOCS / "how-to" / "write-a-plugin.md"
TUTORIAL = DOCS / "tutorial.md"

OFFLINE_PIP = {
    "PIP_NO_INDEX": "1",
    "PIP_NO_DEPS": "1",
    "PIP_UPGRADE": "1",  # what is in the target folder already is replaced
    "PIP_NO_BUILD_ISOLATION": "0",  # pip reads this one upside down: 0 means without isolation
    "PIP_DISABLE_PIP_VERSION_CHECK": "1",
}


class Ended(NamedTuple):
    code: int
    printed: str


@pytest.fixture(scope="module")
def server() -> Iterator[subprocess.Popen[str]]:
    """The runner, which runs guides in forks, because imports take longer than most guides."""
    runner = subprocess.Popen(
        [sys.executable, str(RUNNER)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=os.environ | {"MPLBACKEND": "Agg"},
        text=True,
    )
    with runner:
        yield runner


def run_guide(guide: Path, folder: Path, server: subprocess.Popen[str]) -> Ended:
    """Run a guide in a process of its own; what it installs with pip goes to ``folder/site``."""
    site, work = folder / "site", folder / "work"
    site.mkdir()
    work.mkdir()
    paths = (str(site), os.environ.get("PYTHONPATH", ""))
    programs = (str(Path(sys.executable).parent), os.environ["PATH"])
    environment = {
        **OFFLINE_PIP,
        "PIP_TARGET": str(site),
        "PYTHONPATH": os.pathsep.join(filter(None, paths)),
        "PATH": os.pathsep.join(programs),
    }
    output = folder / "output.txt"
    request = {"guide": str(guide), "folder": str(work), "output": str(output), "environment": environment}
    assert server.stdin is not None
    assert server.stdout is not None
    print(json.dumps(request), file=server.stdin, flush=True)
    code = int(server.stdout.readline())
    return Ended(code, output.read_text(encoding="utf-8"))


_LONG = (
    "README",
    "adapt",
    "choose-a-strategy",
    "cut-the-levels",
    "elasticity",
    "interchange",
    "more-than-one-machine",
    "read-a-report",
    "rules-for-parts",
    "three-dimensions",
    "train-a-model",
    "tutorial",
    "use-the-hierarchy-in-your-solver",
    "virtual-elements",
    "write-a-plugin",
    "write-other-components",
)


def _with_slow_ones() -> list[object]:
    """The guides, with a mark for those that take long."""
    return [
        pytest.param(guide, id=guide.stem, marks=pytest.mark.slow if guide.stem in _LONG else ())
        for guide in GUIDES
    ]


@pytest.mark.parametrize("guide", _with_slow_ones())
def test_every_block_of_the_guide_runs(guide: Path, tmp_path: Path, server: subprocess.Popen[str]) -> None:
    done = run_guide(guide, tmp_path, server)
    assert done.code == 0, done.printed


def test_numbers_under_pictures_are_in_what_the_page_runs_or_prints() -> None:
    lacking = {}
    for guide in GUIDES:
        text = guide.read_text(encoding="utf-8")
        code = " ".join([*re.findall(r"`([^`\n]+)`", text), *(block.text for block in blocks(guide))])
        captions = " ".join(re.findall(r"!\[([^]]*)\]\(", text)).replace(",", "")
        lacking[guide.name] = set(re.findall(r"\d+", captions)) - set(re.findall(r"\d+", code))
    assert {name for name, numbers in lacking.items() if numbers} == set()


@pytest.mark.parametrize("guide", [DOCS.parent / "README.md", TUTORIAL], ids=lambda guide: guide.stem)
def test_the_first_python_of_a_beginner_imports_agglo_core(guide: Path) -> None:
    first = next(block for block in blocks(guide) if block.language == "python")
    assert "import agglo_core as agglo\n" in first.text


@pytest.mark.parametrize("guide", GUIDES, ids=lambda guide: guide.stem)
def test_python_of_the_guide_fits_its_column(guide: Path) -> None:
    """The site shows about 85 columns. Shell commands are wrapped there."""
    kinds = ("python", "output", "sh") if guide == TUTORIAL else ("python",)
    shown = [block for block in blocks(guide) if block.words and block.words[0] in kinds]
    lines = [line for block in shown for line in block.text.splitlines()]
    assert [line for line in lines if len(line) > 76] == []


def test_the_first_plugin_takes_less_than_thirty_lines() -> None:
    written: list[Block] = []
    for block in blocks(PLUGIN):
        if "agglo check" in block.text:
            break
        if block.path is not None:
            written.append(block)
    names = [block.path for block in written]
    assert names == ["pyproject.toml", "agglo_halves/__init__.py", "agglo_halves/halves.py"]
    assert sum(1 for block in written for line in block.text.splitlines() if line.strip()) < 30


def test_nothing_in_the_guide_to_plugins_is_left_unrun() -> None:
    assert {block.language for block in blocks(PLUGIN)} <= {"python", "toml", "sh", "output"}
    assert all(block.path for block in blocks(PLUGIN) if block.language == "toml")


def test_what_was_not_executed_for_other_codes_says_so() -> None:
    for block in blocks(CODES):
        executed = block.words[0] in ("python", "sh", "output") and "no-run" not in block.words
        assert executed != ("not executed here" in block.text.split("\n")[0]), block.line


def test_the_table_of_other_codes_leads_to_its_sections() -> None:
    text = CODES.read_text(encoding="utf-8")
    titles = re.findall(r"^## (.+)$", text, re.MULTILINE)
    slugs = {re.sub(r"[^\w -]", "", title).lower().replace(" ", "-") for title in titles}
    links = re.findall(r"^\| \[[^]]+\]\(#([^)]+)\)", text, re.MULTILINE)
    assert len(links) == 18
    assert slugs - set(links) == {"any-code-a-list"}
    assert set(links) <= slugs


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("a\n```python\nx = 1\n```\n```python\nprint(x + 1)\n```\n```output\n2\n```", ""),
        ("```sh\necho a b c\n```\n```output\na … c\n```", ""),
        ("```python\n# one/two.py\nthree = 3\n```\n```python\nfrom one.two import three\n```", ""),
        ("- item\n  ```sh\n  true\n  ```", ""),
        ("```sh no-run\nfalse\n```\n```text\nfalse\n```\n```\nfalse\n```", ""),
        ("```python needs:no_such_module\n1 / 0\n```", ""),
        ("```python needs:numpy\n1 / 0\n```", "ZeroDivisionError"),
        ("```sh\nfalse | cat\n```", "it.md:2: exit code 1 of"),
        ("\n```python\nx = 1\ny = 1 / 0\n```", 'it.md", line 4, in'),
        ("```sh\necho 1\n```\n\n```output\n2\n```", "it.md:6: the guide says"),
        ("```python\n# one.py\n```\n```python\nname\n```", "NameError"),
    ],
)
def test_the_runner_says_what_is_wrong_and_where(
    tmp_path: Path, text: str, complaint: str, server: subprocess.Popen[str]
) -> None:
    guide = tmp_path / "it.md"
    guide.write_text(text)
    done = run_guide(guide, tmp_path, server)
    assert complaint in done.printed
    assert (done.code == 0) == (complaint == ""), done.printed
