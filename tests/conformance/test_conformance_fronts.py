"""The three fronts: data, pytest, command line; processes that are stopped; outside the repository."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from conformance.mutants.bisectors import Halves, LeftInOnePlace, NamesOfSides, SwapsSides
from conformance.mutants.hanging import Dies
from conformance.mutants.problems import Heat
from conformance.mutants.samples import bars, clips
from two_point_flux import TwoPointFlux

from agglo_core import Component, Diffusion, OptionError, PluginError, Registry, hookimpl
from agglo_core.cli import main
from agglo_core.cli.commands.check import _show
from agglo_core.conformance import Result, check, conformance
from agglo_core.conformance.base.law import Law
from agglo_core.conformance.base.subject import subject_of
from agglo_core.conformance.engine.judging import judge, laws_for
from agglo_core.conformance.inputs.questions import questions
from agglo_core.conformance.laws import all_laws

PLUGIN = """
import numpy as np
from agglo_core import Component, hookimpl

@hookimpl
def agglo_components():
    return [Component("bisector", "mine", "my_plugin:Mine", promises={"deterministic": True, "3d": True}),
            Component("bisector", "names_of_sides", "my_plugin:AsNames"),
            Component("bisector", "endless", "my_plugin:Endless")]

class Mine:
    def bisect(self, graph, rng):
        order = np.argsort(graph.centroids[:, 0], kind="stable")
        sides = np.zeros(graph.n, int)
        sides[order[graph.n // 2 :]] = 1
        return sides

class AsNames(Mine):
    def bisect(self, graph, rng):
        print("to stdout")
        return np.where(super().bisect(graph, rng), "right", "left")

class Endless:
    def __init__(self):
        while True:
            pass

    def bisect(self, graph, rng):
        return graph.centroids[:, 0] > 0
"""
ENTRY_POINTS = "[agglo]\nmine = my_plugin\n"
METADATA = "Metadata-Version: 2.1\nName: my-plugin\nVersion: 0.3\n"


OUTSIDE = """
import io, json, sys
from contextlib import redirect_stdout
sys.modules["pytest"] = None
from agglo_core.cli import main
from agglo_core.conformance import check

def agglo(*arguments):
    text = io.StringIO()
    with redirect_stdout(text):
        try:
            main(list(arguments))
        except SystemExit as end:
            return end.code, text.getvalue()

print(json.dumps({
    "mine": agglo("check", "mine"),
    "names_of_sides": agglo("check", "bisector:names_of_sides", "--json"),
    "endless": agglo("check", "mine/endless", "--timeout", "1", "--json"),
    "failed": [result.law for result in check("names_of_sides") if not result.passed],
}))
"""


@pytest.fixture(scope="module")
def outside(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return exit codes and output for a plugin outside the repository.

    One process makes all calls. It cannot import pytest.
    """
    folder = tmp_path_factory.mktemp("elsewhere")
    (folder / "my_plugin.py").write_text(PLUGIN)
    info = folder / "my_plugin-0.3.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(METADATA)
    (info / "entry_points.txt").write_text(ENTRY_POINTS)
    program = f"import sys; sys.path.insert(0, {str(folder)!r})\n{OUTSIDE}"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])  # others print, too
    return found


# --- data -------------------------------------------------------------------------------------------


def test_results_are_data() -> None:
    results = check("metric:cells", laws=["pickles", "space", "answers", "deterministic", "builds"])
    assert [r.law for r in results] == ["builds", "answers", "space", "deterministic", "pickles"]
    assert all(r.passed and not r.message and r.sentence and r.seconds >= 0 for r in results)
    assert {r.promise for r in results} == {None, "deterministic", "3d", "pickles"}


def test_a_component_may_be_a_name_a_declaration_a_class_or_an_object() -> None:
    titles = [
        subject_of(given).title
        for given in (
            "cells",
            "defaults/cells",
            "metric:cells",
            Component("metric", "cells", "agglo_core.shapes.metrics:Cells"),
            NamesOfSides,
            NamesOfSides(),
        )
    ]
    assert all("'cells'" in title for title in titles[:4])
    assert titles[4:] == ["bisector NamesOfSides"] * 2


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ("nothing", "no component is named 'nothing'; there are .*kmeans"),
        ("intertial", "no component is named 'intertial' \\(did you mean 'inertial'\\?\\)"),
        ("bisector:nothing", "no bisector is named 'nothing'"),
        ("wizard:nothing", "unknown kind"),
        (3, "has none of the methods"),
        (Component("bisector", "not a name", "m:C"), "not an identifier"),
    ],
)
def test_what_cannot_be_checked_is_refused(given: object, says: str) -> None:
    with pytest.raises((PluginError, OptionError), match=says):
        check(given)


def test_a_component_that_needs_an_option_says_so() -> None:
    with pytest.raises(OptionError, match="needs a value for h_star"):
        check("diameter_ratio")
    assert all(r.passed for r in check("sample:squares", options={"n": 3}, laws=["sample_is_mesh"]))


class Declares:
    """A plugin with one kind of problem."""

    @hookimpl
    def agglo_components(self) -> list[Component]:
        target = "conformance.mutants.problems:Heat"
        return [Component("problem", "heat", target, promises={"pickles": True})]


class HeatOnly(TwoPointFlux):
    """Takes the problem of that plugin and no other."""

    accepts = ("heat",)

    def solve(self, problem, hierarchy):  # type: ignore[no-untyped-def]
        if not isinstance(problem, Heat):
            raise OptionError("a heat problem is wanted")
        return super().solve(Diffusion(kappa=problem.conductivity, source=problem.source), hierarchy)


@pytest.fixture
def registry() -> Registry:
    """A registry with that plugin alone."""
    registry = Registry()
    registry.register(Declares(), "mine")
    return registry


def test_names_are_looked_up_in_the_registry_given(registry: Registry) -> None:
    for timeout in (None, 60):
        results = check("heat", timeout=timeout, registry=registry, laws=["answers", "example_given"])
        assert [result.state for result in results] == ["ok", "ok"]
    with pytest.raises(PluginError, match="no component is named 'cells'; there are heat"):
        check("cells", registry=registry)
    conformance("heat", registry=registry)("is_found")


def test_a_solver_is_judged_by_the_problems_it_accepts(registry: Registry) -> None:
    asked = questions(subject_of(HeatOnly, registry=registry))
    assert [case.name for case in asked] == ["the example of problem 'heat'"]
    (answers,) = (law for law in laws_for(subject_of(HeatOnly, registry=registry)) if law.name == "answers")
    assert judge(answers, subject_of(HeatOnly, registry=registry)).passed


@pytest.mark.slow
def test_a_solver_of_another_problem_keeps_the_laws(registry: Registry) -> None:
    assert [r.message for r in check(HeatOnly, registry=registry) if not r.passed] == []


def test_a_sample_is_a_function() -> None:
    assert subject_of(bars, "sample").title == "sample bars"
    for timeout in (None, 60):
        results = check(bars, "sample", timeout, options={"n": 5}, laws=["sample_is_mesh"])
        assert [(result.law, result.state) for result in results] == [("sample_is_mesh", "ok")]


# --- another process --------------------------------------------------------------------------------


@pytest.mark.slow
def test_another_process_says_the_same() -> None:
    here, there = check("inertial"), check("inertial", timeout=60)
    assert [(r.law, r.passed) for r in here] == [(r.law, r.passed) for r in there]
    broken = check(SwapsSides, timeout=60)
    assert next(r.law for r in broken if not r.passed) == "same_seed_same_result"


@pytest.mark.slow
def test_a_component_that_hangs_is_stopped() -> None:
    hangs = Component("bisector", "hangs", "conformance.mutants.hanging:Hangs")
    results = check(hangs, timeout=2)
    messages = {r.law: r.message for r in results}
    assert list(messages) == [law.name for law in laws_for(subject_of(hangs))]
    assert messages["builds"] == ""
    assert "no answer after 2 CPU seconds: look for a loop" in messages["answers"]
    last = next(result for result in results if result.law == "works_in_a_run")
    assert (last.state, last.message) == ("not run", "the component had to be stopped twice")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["slow_to_import:SlowToImport", "hanging:CompilesForLong"])
def test_the_clock_starts_after_the_import_and_stands_still_for_compilers(name: str) -> None:
    slow = Component("bisector", "slow", f"conformance.mutants.{name}")
    messages = {r.law: r.message for r in check(slow, timeout=2)}
    assert [messages[law] for law in ("builds", "surroundings_kept", "answers")] == ["", "", ""]


def test_an_object_cannot_be_sent() -> None:
    with pytest.raises(OptionError, match="importable class"):
        check(NamesOfSides(), timeout=5)
    with pytest.raises(OptionError, match="timeout must be positive"):
        check("cells", timeout=0)


# --- pytest -----------------------------------------------------------------------------------------

test_conformance = conformance("problem:sine")
test_a_failure_that_is_known = conformance(clips, "sample", xfail={"size_matters": "at most 8 cells"})


def test_the_pytest_front_fails_if_nothing_can_run() -> None:
    with pytest.raises(AssertionError, match="no bisector is named 'nothing'"):
        conformance("bisector:nothing")("is_found")


def test_the_pytest_front_names_law_and_remedy() -> None:
    with pytest.raises(
        AssertionError,
        match=r"LeftInOnePlace: two_sides: on a graph of .*return any halving",
    ):
        conformance(LeftInOnePlace)("two_sides")


def test_xfail_is_strict() -> None:
    test = conformance(LeftInOnePlace, xfail={"two_sides": "known"})
    (mark,) = (m for m in test.pytestmark if m.name == "parametrize")  # type: ignore[attr-defined]
    marked = [p for p in mark.args[1] if not isinstance(p, str) and p.marks]
    assert [(p.values, p.marks[0].kwargs) for p in marked] == [
        (("two_sides",), {"strict": True, "reason": "known"})
    ]
    assert len(mark.args[1]) == 1 + len(laws_for(subject_of(LeftInOnePlace)))
    with pytest.raises(OptionError, match="'two_side', which is not a law"):
        conformance(LeftInOnePlace, xfail={"two_side": "misspelt"})
    with pytest.raises(AssertionError, match="'symmetric', which does not apply"):
        conformance(LeftInOnePlace, xfail={"symmetric": "not asked"})("is_found")


class NoBounds:
    """A metric without two of the attributes that its kind requires."""

    better = "low"

    def measure(self, mesh: Any, labels: Any) -> Any:
        return np.bincount(labels, mesh.cell_measures)


def test_one_cause_is_reported_once() -> None:
    laws = ["declares_itself", "answers", "homogeneous", "renaming", "better_is_better"]
    messages = {r.law: r.message for r in check(NoBounds, laws=laws) if not r.passed}
    assert "bounds is None" in messages["declares_itself"]
    assert "homogeneity is None" in messages.pop("declares_itself")
    assert len(messages) > 1
    assert set(messages.values()) == {"the same fault as in declares_itself"}


class CannotBeBuilt:
    """A bisector whose constructor fails."""

    def __init__(self) -> None:
        raise ValueError("no weights")

    def bisect(self, graph: Any, rng: Any) -> Any:
        return graph.centroids[:, 0] > 0


def test_a_component_that_cannot_be_built_breaks_one_law() -> None:
    for chosen in ((), ("two_sides",)):
        (result,) = check(CannotBeBuilt, laws=chosen)
        assert (result.law, result.state) == ("builds", "FAILS")
        assert result.message == "building it raised ValueError: no weights"


class TakesNoGenerator:
    """A bisector without the argument ``rng``."""

    def bisect(self, graph: Any) -> Any:
        return graph.centroids[:, 0] > 0


class ListsOfCells:
    """A bisector that returns the cells of both sides, in two arrays."""

    def bisect(self, graph: Any, rng: Any) -> Any:
        order = np.argsort(graph.centroids[:, 0], kind="stable")
        return order[: graph.n // 2], order[graph.n // 2 :]


@pytest.mark.parametrize(
    ("component", "law", "says"),
    [
        (TakesNoGenerator, "answers", "takes 2 positional arguments but 3 were given. Agglo could not call"),
        (ListsOfCells, "answers", "it returned a tuple"),
    ],
)
def test_a_wrong_call_or_form_is_one_cause(component: type, law: str, says: str) -> None:
    failures = {r.law: r for r in check(component) if not r.passed}
    assert {r.state for r in failures.values()} == {"FAILS"}
    assert says in failures.pop(law).message
    alike = [r.message == f"the same fault as in {law}" for r in failures.values()]
    assert sum(alike) == len(alike) - 1 >= 6
    assert "a run with it failed" in failures["works_in_a_run"].message


class FailsOnTags(Halves):
    """A bisector that cannot split meshes with the tag ``region``."""

    def bisect(self, graph: Any, rng: Any) -> Any:
        if "region" in graph.data:
            raise KeyError("region")
        return super().bisect(graph, rng)


def test_drawn_input_is_small_reproducible_and_shown_as_code(capsys: pytest.CaptureFixture[str]) -> None:
    (result,) = check(FailsOnTags, laws=["side_array"])
    assert check(FailsOnTags, laws=["side_array"])[0].code == result.code
    _show("mine", [result])
    assert result.code in capsys.readouterr().out
    names: dict[str, Any] = {}
    exec(result.code, names)
    assert names["graph"].n <= 9
    assert "region" in names["graph"].data


def test_without_hypothesis_the_error_names_the_extra() -> None:
    code = "import sys; sys.modules['hypothesis'] = None; from agglo_core.conformance import check; "
    command = [sys.executable, "-c", f"{code} check('metric:cells')"]
    process = subprocess.run(command, capture_output=True, text=True)
    assert 'OptionError: the laws need hypothesis: pip install "agglo[check]"' in process.stderr


def test_an_error_of_the_suite_is_not_blamed_on_the_component() -> None:
    def wrong(subject: object) -> None:
        """Sentences are true."""
        raise IndexError("axis 0 index 8887 exceeds matrix dimension 36")

    result = judge(Law(("metric",), None, None, wrong), subject_of("metric:cells"))
    assert result.state == "suite error"
    assert "IndexError: axis 0 index 8887" in result.message
    assert "please report it" in result.message


def test_unknown_laws_are_refused() -> None:
    with pytest.raises(OptionError, match=r"named 'within_bound' \(did you mean 'within_bounds'\?\)"):
        check("metric:cells", laws=["within_bound"])


def test_the_pytest_front_takes_promises_thoroughness_and_a_time_limit() -> None:
    with pytest.raises(AssertionError, match="drop the promise connected"):
        conformance("bisector:inertial", promises={"connected": True})("connected")
    thorough = conformance("bisector:inertial", thorough=True)
    (mark,) = thorough.pytestmark  # type: ignore[attr-defined]
    assert ("time_grows_with_the_mesh",) in [parameter.values for parameter in mark.args[1][1:]]
    with pytest.raises(AssertionError, match=r"the process died \(exit code 7\): it left no message"):
        conformance(Dies, timeout=60)("answers")


# --- command line -----------------------------------------------------------------------------------


def test_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match=r"^0$"):
        main(["check", "sample:squares:n=3", "--json"])
    results = json.loads(capsys.readouterr().out)
    assert {r["law"] for r in results} <= {law.name for law in all_laws()}
    assert all(r["passed"] for r in results)
    assert {r["state"] for r in results} == {"ok"}
    for arguments in (["nothing"], ["diameter_ratio"], ["cells", "--timeout", "0"], ["cells:colour=red"]):
        with pytest.raises(SystemExit, match=r"^2$"):
            main(["check", *arguments])
        assert capsys.readouterr().err.startswith("error: ")


def test_exit_codes_and_the_order_of_the_table(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    holds = Result("builds", "It can be built.", "ok", "", 0.1)
    fails = Result("answers", "It answers.", "FAILS", "it raised", 0.1, None, "here")
    again = replace(fails, law="finite", message="the same fault as in answers")
    idle = Result("holes", "Holes are served.", "not run", "the component had to be stopped twice", 0.0)
    for results, code in (([holds], 0), ([holds, fails, again, idle], 3), ([holds, idle], 4)):
        monkeypatch.setattr("agglo_core.conformance.check", lambda *_, results=results, **__: results)
        with pytest.raises(SystemExit, match=f"^{code}$"):
            main(["check", "cells"])
        text = capsys.readouterr().out
        assert text.rstrip().splitlines()[-1].startswith(f"cells: 1 of {len(results)} laws hold")
        if code == 3:
            assert text.index("answers") < text.index("holes") < text.index("builds")
            assert text.count("it raised") == 1
            assert "2 fail, 1 not run" in text


@pytest.mark.slow
def test_a_plugin_outside_the_repository_passes(outside: dict[str, Any]) -> None:
    code, text = outside["mine"]
    judged = laws_for(subject_of("spectral", promises={"deterministic": True, "3d": True}))
    laws = len([law for law in judged if law.name != "shares_kept"])  # it has no bisect_shares
    assert code == 0, text
    assert f"mine: {laws} of {laws} laws hold" in text


@pytest.mark.slow
def test_messages_for_a_broken_plugin_name_the_remedy(outside: dict[str, Any]) -> None:
    code, text = outside["names_of_sides"]
    assert code == 3
    messages = {r["law"]: r["message"] for r in json.loads(text)}
    assert "one side for each cell" in messages["answers"]
    assert "use logging" in messages["surroundings_kept"]


@pytest.mark.slow
def test_a_hanging_plugin_is_stopped(outside: dict[str, Any]) -> None:
    code, text = outside["endless"]
    assert code == 3
    (result,) = json.loads(text)  # nothing is left to judge
    assert result["law"] == "builds"
    assert "no answer after 1 CPU seconds: look for a loop" in result["message"]


@pytest.mark.slow
def test_the_first_front_needs_no_pytest(outside: dict[str, Any]) -> None:
    assert {"side_array", "surroundings_kept"} <= set(outside["failed"])
