"""The law of programs that are started again: what only one process has decides nothing."""

from __future__ import annotations

from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import require
from agglo_core.conformance.inputs.hard_cases import SIBLINGS
from agglo_core.conformance.inputs.questions import global_random, plain, same
from agglo_core.conformance.process.new_process import answers_elsewhere, asked_elsewhere, can_be_sent


@law(*SIBLINGS, when=can_be_sent)
def same_in_another_process(subject: Subject) -> None:
    """Another process, with other hash values and another current folder, gives the same answers."""
    asked, tool = asked_elsewhere(subject), subject.build()
    with global_random(1):
        here = [plain(subject, tool, case) for case in asked]
    remedy = {
        "built": "hash() of a text, id(), the order of a set, and files in the current folder differ there",
        "pickled": "what it needs must be in its attributes, not in the module",
    }
    for how, there in answers_elsewhere(subject).items():
        for case, one, two in zip(asked, here, there, strict=True):
            require(
                same(one, two),
                f"on {case.name}: {how} for another process, it answers otherwise there: {remedy[how]}",
            )
