"""Every law kills its mutant and lets correct components pass."""

from __future__ import annotations

import re
from dataclasses import replace
from inspect import isfunction
from pathlib import Path

import pytest
from conformance.mutants import CORRECT, MUTANTS, NEWCOMERS
from conformance.mutants.bisectors import AddsData
from conformance.mutants.mutant import Mutant

from agglo_core.conformance import check
from agglo_core.conformance.base.law import Law
from agglo_core.conformance.base.subject import Subject, subject_of
from agglo_core.conformance.engine.judging import judge, laws_for
from agglo_core.conformance.laws import all_laws
from agglo_core.registry import KINDS, PROMISES

GUIDE = Path(__file__).parents[2] / "docs/how-to/write-a-plugin.md"


def first_failure(subject: Subject, name: str) -> tuple[str, str]:
    """Name of the first law that does not hold, and its message; laws before ``name`` get few drawn cases."""
    for law in laws_for(subject):
        result = judge(law, subject if law.name == name else replace(subject, draws=10))
        if not result.passed:
            return result.law, result.message
    return "", ""


def test_names_of_laws_are_unique() -> None:
    laws = all_laws()
    assert len(laws) == len({law.name for law in laws})


def test_a_law_says_in_one_sentence_what_it_wants() -> None:
    laws = all_laws()
    assert [law.name for law in laws if not law.sentence.endswith(".") or ". " in law.sentence] == []
    assert {law.promise for law in laws} <= {None, *PROMISES}


def test_every_law_has_a_mutant_and_every_promise_a_law() -> None:
    assert {mutant.law for mutant in MUTANTS} == {law.name for law in all_laws()}
    assert {law.promise for law in all_laws() if law.promise} == set(PROMISES)


def test_the_guide_says_which_promise_fits_which_kind() -> None:
    text = GUIDE.read_text(encoding="utf-8")
    table = re.findall(r"^\| `(\w+)` \| ([\w, ]+) \| .* \|$", text.split("## Promises")[1], re.M)
    told = {promise: kinds.split(", ") for promise, kinds in table}
    assert told == {
        promise: [name for name, kind in KINDS.items() if promise in kind.promises] for promise in PROMISES
    }
    assert all(f"| `{name}` | {kind.summary} |" in text for name, kind in KINDS.items())


_FIRST = {mutant.law: mutant for mutant in reversed(MUTANTS)}
"""One mutant of each law."""

_BY_ALL = [
    mutant
    for mutant in MUTANTS
    if mutant in _FIRST.values() or mutant.given in NEWCOMERS or mutant.says == "building it changed"
]
"""Mutants judged by all laws; the law on surroundings needs the law that builds the component before it."""


@pytest.mark.slow
@pytest.mark.parametrize("mutant", [each for each in MUTANTS if each not in _BY_ALL], ids=str)
def test_every_other_mutant_is_killed_by_its_law(mutant: Mutant) -> None:
    result = judge(law_of(mutant), subject_of_mutant(mutant))
    assert not result.passed
    assert mutant.says in result.message


@pytest.mark.slow
@pytest.mark.usefixtures("warm_process")
@pytest.mark.parametrize("mutant", _BY_ALL, ids=str)
def test_no_earlier_law_kills_the_mutant_of_a_law(mutant: Mutant) -> None:
    law, message = first_failure(subject_of_mutant(mutant), mutant.law)
    assert law == mutant.law, message
    assert mutant.says in message


def law_of(mutant: Mutant) -> Law:
    """Return the law that the mutant violates."""
    (law,) = (law for law in laws_for(subject_of_mutant(mutant)) if law.name == mutant.law)
    return law


def subject_of_mutant(mutant: Mutant) -> Subject:
    """What is judged: the mutant with its promises."""
    subject = subject_of(mutant.given, mutant.kind, promises=mutant.promises)
    return replace(subject, thorough=mutant.thorough)


@pytest.mark.parametrize("component", NEWCOMERS, ids=lambda each: each.__name__)
def test_messages_for_the_bugs_of_newcomers_name_the_remedy(component: type) -> None:
    mutants = [mutant for mutant in MUTANTS if mutant.given is component]
    assert len({mutant.law for mutant in mutants}) == 1
    message = judge(law_of(mutants[0]), subject_of(component)).message
    assert ": " in message
    assert len(message) > 60


@pytest.mark.slow
@pytest.mark.usefixtures("warm_process")
@pytest.mark.parametrize(("component", "promises"), CORRECT, ids=lambda each: getattr(each, "__name__", ""))
def test_correct_components_pass(component: object, promises: dict[str, bool]) -> None:
    kind = "sample" if isfunction(component) else None
    assert [r for r in check(component, kind, promises=promises) if not r.passed] == []


def test_a_check_never_stops_at_the_first_failure() -> None:
    broken = next(mutant.given for mutant in MUTANTS if mutant.law == "answers")
    results = check(broken)
    assert [r.law for r in results] == [law.name for law in laws_for(subject_of(broken))]
    assert 1 < sum(not r.passed for r in results) < len(results)


@pytest.mark.slow
def test_what_a_mutant_does_to_the_small_meshes_stays_with_it() -> None:
    _judged_here(subject_of(AddsData))
    assert all(_judged_here(subject_of("bisector:inertial")))


def _judged_here(subject: Subject) -> list[bool]:
    """Whether each law holds, but for the one that starts a process: its meshes are its own."""
    laws = [law for law in laws_for(subject) if law.name != "same_in_another_process"]
    return [judge(law, subject).passed for law in laws]
