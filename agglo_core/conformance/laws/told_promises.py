"""The law of what a bisector returns from for_target: it is a bisector too, and promises what it did."""

from __future__ import annotations

from dataclasses import replace

from agglo_core.conformance.base.asking import for_target
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import Broken
from agglo_core.conformance.laws import laws_of
from agglo_core.conformance.laws.bisector import told
from agglo_core.errors import AggloError
from agglo_core.protocols import Target

_TARGETS = (Target(parts=2), Target(parts=3), Target(parts=5), Target(h_star=0.3), Target(h_star=30.0))
_JUDGED = (
    "side_array",
    "side_values",
    "two_sides",
    "input_untouched",
    "same_seed_same_result",
    "global_random_state",
    "survives",
    "a_level_is_its_blocks",
    "deterministic",
    "connected",
    "balanced",
    "invariant",
    "space",
    "pickles",
)


@law("bisector", when=told)
def told_keeps_promises(subject: Subject) -> None:
    """What for_target returns obeys the laws of bisectors too, and keeps the promises of the original."""
    judged = [each for each in laws_of("bisector") if each.name in _JUDGED and each.applies(subject)]
    for target in _TARGETS:
        tool = subject.build()
        try:
            if for_target(tool, target) is tool:
                continue
        except AggloError:  # refused
            continue
        for each in judged:
            try:
                each.judge(replace(subject, told=target))
            except Broken as error:
                raise Broken(f"for {target}, {each.name}: {error}") from error
