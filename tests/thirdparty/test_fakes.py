"""Broken, clashing, misbehaving plugins installed together: agglo lives, explains, names the culprit."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from thirdparty.fakes import FAKES, MISBEHAVING, Fake, Use
from thirdparty.installing import Answer, converse, environment

pytestmark = pytest.mark.slow

LISTING = "plugins --json"
TAKEN = "runner/run"
WORKING = {
    "the default": "run strip:n=8 --parts 4 --json",
    "our kmeans": "run strip:n=8 --bisector kmeans --parts 4 --json",
    "the stranger's kmeans": "run strip:n=8 --bisector usurper/kmeans --parts 4 --json",
    "one twin": "run strip:n=8 --bisector castor/twins --parts 4 --json",
    "the other twin": "run strip:n=8 --bisector pollux/twins --parts 4 --json",
    "a comb and our fixer": "run strip:n=8 --bisector comb --parts 4 --json",
    "a declared fallback": "run strip:n=8 --bisector modest --parts 4 --json",
    "a watcher that raises": "run strip:n=8 --bisector heckler --parts 4 --json",
}
USES = [pytest.param(fake, use, id=fake.name) for fake in FAKES for use in fake.uses]
UNUSABLE = {
    "torn": "distribution agglo-torn 0.1",
    "needy": "pip install no_such_package",
    "twins": "distribution agglo-pollux 2.0",
    "nobody": "no bisector is named 'nobody'",
}
HEAVY = ("numpy", "scipy", "numba", "sklearn", "pymetis", "networkx", "shapely", "matplotlib", "meshlane")


@pytest.fixture(scope="module")
def answers(zoo: Path, tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Answer]:
    """What agglo answered to each command line, all given in one interpreter."""
    uses = [use.arguments for fake in FAKES for use in fake.uses]
    checks = [f"check bisector:{name}" for name in UNUSABLE]
    commands = list(dict.fromkeys([LISTING, TAKEN, *WORKING.values(), *uses, *checks]))
    given = converse(zoo, [each.split() for each in commands], tmp_path_factory.mktemp("work"))
    return dict(zip(commands, given, strict=True))


def listed(answers: Mapping[str, Answer], fake: Fake) -> dict[str, Any]:
    """The one record of a fake."""
    (record,) = [each for each in json.loads(answers[LISTING].out) if each["plugin"] == fake.name]
    return dict(record)


@pytest.mark.parametrize("fake", FAKES, ids=lambda fake: fake.name)
def test_each_is_listed_with_state_reason_and_origin(answers: Mapping[str, Answer], fake: Fake) -> None:
    record = listed(answers, fake)
    assert record["state"] == fake.state
    assert fake.reason in record["reason"]
    assert bool(record["reason"]) == (fake.state != "ok")
    assert (record["distribution"], record["version"]) == (f"agglo-{fake.name}", fake.version)


@pytest.mark.parametrize(("fake", "use"), USES)
def test_use_fails_naming_the_culprit(answers: Mapping[str, Answer], fake: Fake, use: Use) -> None:
    answer = answers[use.arguments]
    assert answer.code == 2
    assert answer.out == ""
    (line,) = [line for line in answer.err.splitlines() if not line.startswith(("note: ", "warning: "))]
    assert line.startswith("error: ")
    assert use.complaint in line
    assert f"plugin '{fake.name}'" in line
    assert fake.origin in line


@pytest.mark.parametrize("what", WORKING)
def test_all_others_work_as_ever(answers: Mapping[str, Answer], what: str) -> None:
    answer = answers[WORKING[what]]
    assert answer.code == 0, answer.err
    (run,) = json.loads(answer.out)["runs"]
    assert [(level["parts"], level["connected"]) for level in run["levels"]] == [(4, 1.0)]


def test_repairs_are_counted_and_never_silent(answers: Mapping[str, Answer]) -> None:
    def statistics(what: str) -> dict[str, Any]:
        (run,) = json.loads(answers[WORKING[what]].out)["runs"]
        return dict(run["statistics"])

    assert statistics("a declared fallback")["fallbacks"] == 3  # 1 piece, then 2
    assert statistics("a comb and our fixer")["repairs"] > 0
    assert statistics("our kmeans")["fallbacks"] == statistics("our kmeans")["repairs"] == 0


def test_a_watcher_that_raises_is_named(answers: Mapping[str, Answer]) -> None:
    assert "plugin 'heckler (agglo-heckler)' is not called any more" in answers[WORKING["the default"]].err


def test_a_command_whose_name_is_taken_has_another(answers: Mapping[str, Answer]) -> None:
    assert (answers[TAKEN].code, answers[TAKEN].out) == (0, "mine\n")


def test_a_twin_works_when_the_other_is_blocked(
    zoo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AGGLO_BLOCK", "pollux")
    command = ["run", "strip:n=8", "--bisector", "twins", "--parts", "4", "--quiet"]
    (answer,) = converse(zoo, [command], tmp_path)
    assert (answer.code, answer.err) == (0, "")


@pytest.fixture(scope="module")
def first_messages(zoo: Path) -> Mapping[str, str | None]:
    """Message of the first law that each of the misbehaving breaks."""
    source = f"""
import json
from agglo_core.conformance.base.subject import subject_of
from agglo_core.conformance.engine.judging import judge, laws_for

def first_message(name):
    subject = subject_of(name)
    results = (judge(law, subject) for law in laws_for(subject))
    return next((result.message for result in results if not result.passed), None)

print(json.dumps({{name: first_message(name) for name in {[fake.name for fake in MISBEHAVING]}}}))
"""
    done = subprocess.run(
        [sys.executable, "-c", source], capture_output=True, text=True, env=environment(zoo), check=False
    )
    assert done.returncode == 0, done.stderr
    return dict(json.loads(done.stdout))


@pytest.mark.parametrize("fake", MISBEHAVING, ids=lambda fake: fake.name)
def test_the_suite_finds_what_is_wrong(first_messages: Mapping[str, str | None], fake: Fake) -> None:
    assert first_messages[fake.name]


def test_a_component_that_hangs_is_stopped(zoo: Path, tmp_path: Path) -> None:
    (answer,) = converse(zoo, [["check", "bisector:sleeper", "--timeout", "1", "--json"]], tmp_path)
    assert answer.code == 3
    messages = [result["message"] for result in json.loads(answer.out) if not result["passed"]]
    assert messages[0].startswith("no answer after 1 CPU seconds")
    assert messages[-1] == "the component had to be stopped twice"
    assert json.loads(answer.out)[-1]["state"] == "not run"


@pytest.mark.parametrize("name", UNUSABLE)
def test_what_cannot_be_used_cannot_be_checked(answers: Mapping[str, Answer], name: str) -> None:
    answer = answers[f"check bisector:{name}"]
    assert (answer.code, answer.out) == (2, "")
    assert UNUSABLE[name] in answer.err


@pytest.mark.parametrize("arguments", [["plugins"], ["plugins", "-v"], ["plugins", "--json"], ["--help"]])
def test_thirty_plugins_load_nothing_heavy(thirty: Path, arguments: list[str]) -> None:
    source = f"""
import sys
from agglo_core.cli import main

try:
    main({arguments})
finally:
    print([name for name in {HEAVY} if name in sys.modules], file=sys.stderr)
"""
    done = subprocess.run(
        [sys.executable, "-c", source], capture_output=True, text=True, env=environment(thirty), check=True
    )
    assert done.stderr == "[]\n"
    if arguments[0] == "plugins":
        assert all(f"agglo-extra{i}" in done.stdout for i in range(30))
