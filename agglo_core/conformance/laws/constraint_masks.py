"""Laws of the masks of a constraint, and of runs under it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agglo_core.arrays import Int, Mask, frozen_int
from agglo_core.conformance import small_meshes
from agglo_core.conformance.case import Case
from agglo_core.conformance.law import law
from agglo_core.conformance.mesh_cases import bands, tagged
from agglo_core.conformance.own_components import own_components
from agglo_core.conformance.questions import answer, in_words, questions
from agglo_core.conformance.subject import Subject
from agglo_core.conformance.verdict import Broken, require
from agglo_core.errors import AggloError
from agglo_core.graph import Graph


@law("constraint")
def masks(subject: Subject) -> None:
    """It answers in booleans: one for each CSR entry, for each part, for each piece."""
    for case in questions(subject):
        graph, labels = case.given
        parts = int(labels.max()) + 1
        wanted = {"forbidden": len(graph.indices), "admissible": parts, "finished": parts}
        for method, given in answer(subject, subject.build(), case).items():
            require(
                isinstance(given, np.ndarray) and given.shape == (wanted[method],) and given.dtype == bool,
                f"on {case.name}: {method} returned {in_words(given)}, expected booleans of shape "
                f"({wanted[method]},)",
            )


@law("constraint", when=lambda subject: subject.has("forbidden"))
def both_directions(subject: Subject) -> None:
    """What it forbids of a cell and its neighbour it forbids of the neighbour and the cell."""
    for case in questions(subject):
        graph = case.given[0]
        pairs = _pairs(graph, answer(subject, subject.build(), case)["forbidden"])
        one_way = np.flatnonzero(pairs != pairs.T)
        require(
            not len(one_way),
            f"on {case.name}: {len(one_way) // 2} edges are forbidden in one direction alone: each edge "
            "stands in the graph twice, treat both cells of an entry alike",
        )


@law("constraint")
def numbering_ignored(subject: Subject) -> None:
    """Renumbering the cells changes nothing."""
    for mesh in (small_meshes.grid(9, 7, jitter=0.25), small_meshes.mixed()):
        here = tagged(mesh)
        moved, order = small_meshes.changed(here, "renumbered")
        labels = bands(mesh, 4)
        asked = Case(mesh.name, (here.graph, labels))
        tags = {name: values[order] for name, values in here.cell_tags.items()}
        moved = replace(moved, cell_tags=tags)
        again = Case(f"{mesh.name}, renumbered", (moved.graph, frozen_int(labels[order])))
        one, two = (_taken(subject, case) for case in (asked, again))
        for method in one.keys() & two.keys():
            same = np.array_equal(one[method], two[method])
            if method == "forbidden":
                before, after = _pairs(here.graph, one[method]), _pairs(moved.graph, two[method])
                same = np.array_equal(before[np.ix_(order, order)], after)
            require(
                same,
                f"on {again.name}: {method} answers differently: use tags and geometry, not cell numbers",
            )


@law("constraint", when=lambda subject: subject.has("forbidden"))
def constraint_kept(subject: Subject) -> None:
    """In a run under it every part is connected without the edges it forbids."""
    from agglo_core.agglomeration.pipeline import agglomerate

    graph = tagged(small_meshes.grid(9, 7, jitter=0.2)).graph
    tool = subject.build()
    try:
        chosen = {"bisector": "inertial", "constraints": [tool], "registry": own_components()}
        labels = agglomerate(graph, n_parts=12, **chosen).levels[0]  # type: ignore[arg-type]
    except AggloError as error:
        raise Broken(f"a run under it failed: {error}") from error
    seen = answer(subject, tool, Case("the parts of a run", (graph, labels)))
    pieces = int(graph.without_edges(seen["forbidden"]).components(labels).max()) + 1
    parts = int(labels.max()) + 1
    require(
        pieces == parts,
        f"the {parts} parts of a run are {pieces} without the edges it forbids: always forbid the same",
    )


def _pairs(graph: Graph, mask: Mask) -> Int:
    """Matrix ``(n, n)`` of 1 for entries of the graph that the mask marks."""
    rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    matrix = np.zeros((graph.n, graph.n), np.int64)
    matrix[rows, graph.indices] = mask
    return matrix


def _taken(subject: Subject, case: Case) -> dict[str, Mask]:
    """The answer; nothing where it is refused."""
    try:
        return dict(answer(subject, subject.build(), case))
    except Broken as error:
        if isinstance(error.__cause__, AggloError):
            return {}
        raise
