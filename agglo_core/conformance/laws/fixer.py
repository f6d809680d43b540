"""Laws of the labels that a connectivity fixer returns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agglo_core.agglomeration.border import broken_blocks
from agglo_core.arrays import frozen_int
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import Broken, require
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.cases import cases
from agglo_core.conformance.inputs.questions import every_graph, in_space, plain
from agglo_core.conformance.laws.refiner import loose_parts


@law("fixer")
def parts_connected(subject: Subject) -> None:
    """Afterwards every part is connected."""
    for case in every_graph(subject):
        pieces = loose_parts(case.given[0], plain(subject, subject.build(), case))
        loose = [part for part in pieces if pieces[part] > 1]
        require(
            not loose,
            f"on {case.name}: {len(loose)} parts are still in pieces, as part {loose and loose[0][1]} of "
            f"block {loose and loose[0][0]}: give every piece but the largest to a neighbouring part",
        )


@law("fixer")
def connected_left_alone(subject: Subject) -> None:
    """In a block whose parts are all connected the labels come back as they are."""
    for case in [*every_graph(subject), *in_space(subject)]:
        graph, labels = case.given
        broken = np.isin(graph.block_ids, broken_blocks(graph, labels))
        if broken.all():
            continue
        changed = np.flatnonzero((plain(subject, subject.build(), case) != labels) & ~broken)
        require(
            not len(changed),
            f"on {case.name}: nothing was broken in their blocks, yet {len(changed)} cells changed their "
            "part: return labels where every part is connected",
        )


@law("fixer")
def fixed_once(subject: Subject) -> None:
    """Fixing its own result a second time changes nothing."""
    for case in [*every_graph(subject), *in_space(subject)]:
        once = frozen_int(plain(subject, subject.build(), case))
        twice = plain(subject, subject.build(), replace(case, given=(case.given[0], once)))
        require(
            np.array_equal(once, twice),
            f"on {case.name}: fixing its own result changed it again: leave connected parts alone",
        )


@law("fixer")
def disconnected_block_refused(subject: Subject) -> None:
    """A block that is itself in two pieces is refused with a ValueError: no labels would help."""
    graph = small_meshes.apart().graph
    case = replace(cases("fixer")[0], name="two components", given=(graph, frozen_int(np.zeros(graph.n))))
    try:
        plain(subject, subject.build(), case)
    except Broken as error:
        if isinstance(error.__cause__, ValueError):
            return
        raise
    raise Broken("a disconnected block was returned as if it could be fixed: raise a ValueError instead")
