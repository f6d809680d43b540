"""Laws of what a metric says that a move would change."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import require
from agglo_core.conformance.inputs.cases import cases
from agglo_core.conformance.inputs.metric_cases import by_hand, many_alone, solids, various
from agglo_core.conformance.inputs.questions import in_words, plain
from agglo_core.graph import Graph
from agglo_core.mesh import Mesh

_MOVES = 12  # of a question; every one is measured twice


@law("metric", when=lambda subject: subject.has("changes"))
def changes_add_up(subject: Subject) -> None:
    """If it has ``changes``, they are what moving one cell does to the sum of its values."""
    space = solids()[:2] if subject.promised("3d") else []
    for case in [*cases("metric"), *by_hand()[:3], *various()[:2], _many(), *space]:
        mesh, labels = case.given
        cells, parts = _moves(mesh, labels, _MOVES if mesh.n_cells < 1000 else 3)
        tool = subject.build()
        weights = frozen_float(1.0 + np.arange(mesh.n_cells) % 3)  # a user's, unlike the measures
        told = _told(case.name, tool, replace(mesh.graph, weights=weights), labels, cells, parts)
        before, sums = plain(subject, tool, case).sum(), []
        for cell, part in zip(cells, parts, strict=True):
            moved = np.array(labels)
            moved[cell] = part
            sums.append(plain(subject, tool, Case(case.name, (mesh, frozen_int(moved)))).sum() - before)
        size = 1 + abs(before)
        off = np.flatnonzero(np.abs(told - sums) > 1e-8 * size)
        require(
            not len(off),
            f"on {case.name}: changes says {told[off[:1]]}, measure changes by {np.array(sums)[off[:1]]}: it "
            "is the sum of all values after the move, less the sum before",
        )


@law("metric", when=lambda subject: subject.has("changes"))
def changes_of_these_labels(subject: Subject) -> None:
    """If it has ``changes``, they are those of the labels as they are now, in an array that others write."""
    for case in [*cases("metric")[3:], *by_hand()[:1], _many()]:
        mesh, labels = case.given
        tool, own = subject.build(), np.array(labels)
        for _ in range(3):
            cells, parts = _moves(mesh, own)
            if not len(cells):
                break
            given = _told(case.name, tool, mesh.graph, own, cells, parts)
            wanted = _told(case.name, subject.build(), mesh.graph, frozen_int(own), cells, parts)
            require(
                bool(np.allclose(given, wanted, rtol=1e-9, atol=1e-9 * (1 + np.abs(wanted).max()))),
                f"on {case.name}, after a cell was moved in the same array: changes says {given[:3]}, a "
                f"fresh object {wanted[:3]}: an array that is the same object may hold other labels by now",
            )
            own[cells[-1]] = parts[-1]


def _told(name: str, tool: Any, graph: Graph, labels: Int, cells: Int, parts: Int) -> Float:
    told = np.asarray(tool.changes(graph, labels, cells, parts))
    require(
        told.shape == cells.shape,
        f"on {name}: changes returned {in_words(told)} for {len(cells)} moves, expected one each",
    )
    return told


def _many() -> Case:
    """More than a thousand parts, some of two cells."""
    mesh, names = many_alone().given
    _, labels = np.unique(np.where(names > 1000, names // 2 * 2, names), return_inverse=True)
    return Case("a thousand parts", (mesh, frozen_int(labels)))


def _moves(mesh: Mesh, labels: Int, most: int = _MOVES) -> tuple[Int, Int]:
    """Some moves of a cell to a neighbour's part that do not empty its own, and one to its own part."""
    graph, sizes = mesh.graph, np.bincount(labels)
    rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    chosen = (labels[rows] != labels[graph.indices]) & (sizes[labels[rows]] > 1)
    few = np.flatnonzero(chosen)[:: max(1, chosen.sum() // most)]
    stays = rows[few[:1]]
    cells = np.concatenate((stays, rows[few]))
    return frozen_int(cells), frozen_int(np.concatenate((labels[stays], labels[graph.indices[few]])))
