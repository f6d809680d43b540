"""Laws for the boolean masks of a constraint, and for agglomeration runs under a constraint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agglo_core.arrays import Int, Mask, frozen_int
from agglo_core.conformance.base import Broken, Case, Subject, in_words, law, require
from agglo_core.conformance.base.own_components import own_components
from agglo_core.conformance.inputs.drawn import DrawnMesh, drawn_labels
from agglo_core.conformance.inputs.mesh_cases import tag_cells_and_faces
from agglo_core.conformance.inputs.mesh_changes import renumber_mesh
from agglo_core.conformance.inputs.questions import answer
from agglo_core.conformance.inputs.strategies import constraint_cases
from agglo_core.errors import AggloError
from agglo_core.graph import Graph
from agglo_core.mesh import Mesh

_EXAMPLES = 40  # drawn meshes for each law


@law("constraint", draw=constraint_cases, examples=_EXAMPLES)
def masks(subject: Subject, case: Case) -> None:
    """Masks are booleans, one per part or CSR entry, alike for both directions of an edge."""
    mesh, labels = case.given
    parts = int(labels.max()) + 1
    lengths = {"forbidden": len(mesh.graph.indices), "admissible": parts, "incomplete": parts}
    answers = _answer_unless_refused(subject, case)
    for method, mask in answers.items():
        require(
            mask.shape == (lengths[method],) and (mask.dtype == bool or not mask.size),
            f"{method} returned {in_words(mask)}, expected booleans of shape ({lengths[method]},)",
        )
    if "forbidden" in answers:
        pairs = _pairs(mesh.graph, answers["forbidden"])
        one_way = np.flatnonzero(pairs != pairs.T)
        require(
            not len(one_way),
            f"{len(one_way) // 2} edges are forbidden in one direction only: the graph stores each edge "
            "twice; treat both cells of an entry alike",
        )


@law("constraint", draw=constraint_cases, examples=_EXAMPLES)
def numbering_ignored(subject: Subject, case: Case) -> None:
    """Constraints do not depend on the numbering of cells, faces and points."""
    mesh, labels = case.given
    renumbered, order = renumber_mesh(mesh)
    other = replace(case, given=(renumbered, frozen_int(labels[order])))
    before, after = (_answer_unless_refused(subject, each) for each in (case, other))
    for method in before.keys() & after.keys():
        equal = np.array_equal(before[method], after[method])
        if method == "forbidden":
            pairs = _pairs(mesh.graph, before[method])[np.ix_(order, order)]
            equal = np.array_equal(pairs, _pairs(renumbered.graph, after[method]))
        require(
            equal,
            f"on {case.name}, renumbered: {method} answers differently: use tags and geometry, not cell "
            "numbers",
        )


@law("constraint", draw=constraint_cases, examples=_EXAMPLES)
def large_tags(subject: Subject, case: Case) -> None:
    """A constraint that gives equal masks for the tags 1, 2, … and 6, 7, … does so for large values."""
    mesh, labels = case.given
    small, shifted, *large = (
        _answer_unless_refused(subject, replace(case, given=(_retagged(mesh, *change), labels)))
        for change in ((1, 0), (1, 5), (256, 0), (1, 2_100_000))
    )
    for method in small.keys() & shifted.keys():
        by_value = not np.array_equal(small[method], shifted[method])
        require(
            by_value or all(np.array_equal(small[method], masks.get(method, ())) for masks in large),
            f"{method} answers differently where the tags 1, 2, … are 256, 512, … or 2,100,001, …: compare "
            "tags as integers of 64 bits",
        )


def _retagged(mesh: Mesh, factor: int, shift: int) -> Mesh:
    """Replace the positive values of each tag by factor · 1 + shift, factor · 2 + shift, …"""

    def renumber(tag: Int) -> Int:
        values, place = np.unique(tag, return_inverse=True)
        rank = place - int((values <= 0).sum()) + 1
        return frozen_int(np.where(tag > 0, factor * rank + shift, tag))

    return replace(
        mesh,
        cell_tags={name: renumber(tag) for name, tag in mesh.cell_tags.items()},
        face_tags={name: renumber(tag) for name, tag in mesh.face_tags.items()},
    )


@law("constraint", draw=constraint_cases, examples=_EXAMPLES)
def pieces_admissible(subject: Subject, case: Case) -> None:
    """A single cell is admissible, and so is each half of an admissible part, so that splitting ends."""
    mesh, labels = case.given
    answers = _answer_unless_refused(subject, case)
    if "admissible" not in answers:
        return
    cells = Case(f"{case.name}, cell by cell", (mesh, frozen_int(np.arange(mesh.n_cells))))
    require(
        bool(answer(subject, cells)["admissible"].all()),
        f"on {cells.name}: a cell is not admissible, and cannot be split",
    )
    # Parts cut by the halves of the mesh; ``part_of_piece`` maps each piece to its part.
    number = np.unique(2 * labels + drawn_labels(mesh.graph, "strips", 2), return_inverse=True)[1]
    finer = Case(f"{case.name}, parts halved", (mesh, frozen_int(number)))
    part_of_piece = np.empty(int(number.max()) + 1, np.int64)
    part_of_piece[number] = labels
    piece_mask = answer(subject, finer)["admissible"]
    require(
        bool((piece_mask | ~answers["admissible"][part_of_piece]).all()),
        f"on {finer.name}: a piece of an admissible part is not admissible",
    )


@law("constraint")
def constraint_kept(subject: Subject) -> None:
    """In a run every part is admissible, and connected without the forbidden edges."""
    from agglo_core.agglomeration.one_call import agglomerate

    mesh, tool = tag_cells_and_faces(DrawnMesh(cells=63, jitter=0.25).mesh), subject.build()
    try:
        labels = agglomerate(
            mesh, n_parts=21, bisector="inertial", constraints=[tool], registry=own_components()
        ).levels[0]
    except AggloError as error:
        raise Broken(f"a run under it failed: {error}") from error
    answers = answer(subject, Case("the parts of a run", (mesh, labels)), tool)
    require(
        "admissible" not in answers or bool(answers["admissible"].all()),
        "a part of a run is not admissible: return the same answer in every call",
    )
    if "forbidden" in answers:
        pieces = int(mesh.graph.without_edges(answers["forbidden"]).components(labels).max()) + 1
        parts = int(labels.max()) + 1
        require(
            pieces == parts,
            f"the {parts} parts of a run fall into {pieces} pieces without the edges it forbids: always "
            "forbid the same edges",
        )


def _pairs(graph: Graph, mask: Mask) -> Int:
    """Return a mask of graph edges as a dense matrix ``(n, n)`` with entries 0 and 1."""
    rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    matrix = np.zeros((graph.n, graph.n), np.int64)
    matrix[rows, graph.indices] = mask
    return matrix


def _answer_unless_refused(subject: Subject, case: Case) -> dict[str, Mask]:
    """Return the masks of a constraint, or an empty dictionary if it refuses the test case."""
    return dict(answer(subject, case, refusal={}))
