"""Laws for the masks of a constraint, and for runs under a constraint."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Int, Mask, frozen_int
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.own_components import own_components
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import Broken, require
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.mesh_cases import bands, marked
from agglo_core.conformance.inputs.questions import answer, in_words, questions
from agglo_core.errors import AggloError
from agglo_core.graph import Graph


@law("constraint")
def masks(subject: Subject) -> None:
    """Masks are boolean arrays, with one entry per CSR entry or per part."""
    for case in questions(subject):
        mesh, labels = case.given
        parts = int(labels.max()) + 1
        wanted = {"forbidden": len(mesh.graph.indices), "admissible": parts, "incomplete": parts}
        for method, given in answer(subject, subject.build(), case).items():
            require(
                isinstance(given, np.ndarray) and given.shape == (wanted[method],) and given.dtype == bool,
                f"on {case.name}: {method} returned {in_words(given)}, expected booleans of shape "
                f"({wanted[method]},)",
            )


@law("constraint", when=lambda subject: subject.has("forbidden") or subject.has("for_mesh"))
def both_directions(subject: Subject) -> None:
    """An edge is forbidden in both directions or in neither."""
    for case in questions(subject):
        given = answer(subject, subject.build(), case)
        if "forbidden" not in given:
            continue
        pairs = _pairs(case.given[0].graph, given["forbidden"])
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
        here = marked(mesh)
        moved, order = small_meshes.changed(here, "renumbered")
        labels = bands(mesh, 4)
        asked = Case(mesh.name, (here, labels))
        again = Case(f"{mesh.name}, renumbered", (moved, frozen_int(labels[order])))
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


@law("constraint", when=lambda subject: subject.has("forbidden") or subject.has("for_mesh"))
def constraint_kept(subject: Subject) -> None:
    """In a run with the constraint every part is connected without the forbidden edges."""
    from agglo_core.agglomeration.one_call import agglomerate

    mesh = marked(small_meshes.grid(9, 7, jitter=0.2))
    tool = subject.build()
    try:
        chosen = {"bisector": "inertial", "constraints": [tool], "registry": own_components()}
        labels = agglomerate(mesh, n_parts=12, **chosen).levels[0]  # type: ignore[arg-type]
    except AggloError as error:
        raise Broken(f"a run under it failed: {error}") from error
    seen = answer(subject, tool, Case("the parts of a run", (mesh, labels)))
    if "forbidden" not in seen:
        return
    pieces = int(mesh.graph.without_edges(seen["forbidden"]).components(labels).max()) + 1
    parts = int(labels.max()) + 1
    require(
        pieces == parts,
        f"the {parts} parts of a run are {pieces} without the edges it forbids: always forbid the same",
    )


@law("constraint", when=lambda subject: subject.has("admissible") or subject.has("for_mesh"))
def pieces_admissible(subject: Subject) -> None:
    """A single cell is admissible, and so is each half of an admissible part, so that splitting ends."""
    for case in questions(subject):
        mesh, labels = case.given
        given = answer(subject, subject.build(), case)
        if "admissible" not in given:
            continue
        # Single cells.
        cells = Case(f"{case.name}, cell by cell", (mesh, frozen_int(np.arange(mesh.n_cells))))
        require(
            bool(answer(subject, subject.build(), cells)["admissible"].all()),
            f"on {cells.name}: a cell is not admissible, and cannot be split",
        )
        # Parts cut by the halves of the mesh; ``above`` maps each piece to its part.
        halves = bands(mesh, 2)
        number = np.unique(2 * labels + halves, return_inverse=True)[1]
        finer = Case(f"{case.name}, parts halved", (mesh, frozen_int(number)))
        above = np.empty(int(number.max()) + 1, np.int64)
        above[number] = labels
        good = answer(subject, subject.build(), finer)["admissible"]
        require(
            bool((good | ~given["admissible"][above]).all()),
            f"on {finer.name}: a piece of an admissible part is not",
        )


@law("constraint", when=lambda subject: subject.has("admissible") or subject.has("for_mesh"))
def parts_admissible(subject: Subject) -> None:
    """In a run with the constraint every part is admissible."""
    from agglo_core.agglomeration.one_call import agglomerate

    mesh = marked(small_meshes.grid(9, 7, jitter=0.2))
    tool = subject.build()
    try:
        labels = agglomerate(
            mesh, n_parts=21, bisector="inertial", constraints=[tool], registry=own_components()
        ).levels[0]
    except AggloError as error:
        raise Broken(f"a run under it failed: {error}") from error
    given = answer(subject, tool, Case("the parts of a run", (mesh, labels)))
    if "admissible" in given:
        honest = bool(given["admissible"].all())
        require(honest, "a part of a run is not admissible: it must always answer alike")


def _pairs(graph: Graph, mask: Mask) -> Int:
    """Return the mask as a dense matrix ``(n, n)`` with entries 0 and 1."""
    rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    matrix = np.zeros((graph.n, graph.n), np.int64)
    matrix[rows, graph.indices] = mask
    return matrix


def _taken(subject: Subject, case: Case) -> dict[str, Mask]:
    """Return the answer, or an empty dictionary if the case is refused."""
    try:
        return dict(answer(subject, subject.build(), case))
    except Broken as error:
        if isinstance(error.__cause__, AggloError):
            return {}
        raise
