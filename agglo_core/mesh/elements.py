"""Convert standard 3-D elements (VTK node order) to polyhedra, by a table of faces per element type."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Int, Mask, frozen_int
from agglo_core.errors import MeshError

# vertices of each face, as positions among the nodes of the element
_FACES: Mapping[str, tuple[tuple[int, ...], ...]] = {
    "tetra": ((0, 1, 3), (1, 2, 3), (2, 0, 3), (0, 2, 1)),
    "hexahedron": ((0, 4, 7, 3), (1, 2, 6, 5), (0, 1, 5, 4), (3, 7, 6, 2), (0, 3, 2, 1), (4, 5, 6, 7)),
    "wedge": ((0, 1, 2), (3, 5, 4), (0, 3, 4, 1), (1, 4, 5, 2), (2, 5, 3, 0)),
    "pyramid": ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
    "pentagonal prism": (
        (4, 3, 2, 1, 0), (5, 6, 7, 8, 9), (0, 1, 6, 5), (1, 2, 7, 6), (2, 3, 8, 7), (3, 4, 9, 8),
        (4, 0, 5, 9),
    ),
    "hexagonal prism": (
        (5, 4, 3, 2, 1, 0), (6, 7, 8, 9, 10, 11), (0, 1, 7, 6), (1, 2, 8, 7), (2, 3, 9, 8), (3, 4, 10, 9),
        (4, 5, 11, 10), (5, 0, 6, 11),
    ),
}  # fmt: skip
# number of nodes per element
CORNERS: Mapping[str, int] = {
    "tetra": 4,
    "hexahedron": 8,
    "wedge": 6,
    "pyramid": 5,
    "pentagonal prism": 10,
    "hexagonal prism": 12,
}
_FOLDED_TETRA = (0, 1, 2, 2, 3, 3, 3, 3)  # hexahedron nodes 0, 1, 2, 3, 3, 3, 3, 3 as a folded hexahedron


class Polyhedra(NamedTuple):
    """Polyhedra as CSR of face loops: cell c has the loops ``cell_offsets[c]:cell_offsets[c + 1]``."""

    cell_offsets: Int  # (n_cells + 1,)
    loop_offsets: Int  # (n_loops + 1,)
    vertices: Int


def polyhedra_from_elements(blocks: Mapping[str, ArrayLike]) -> Polyhedra:
    """Convert blocks of standard elements to polyhedra with outward faces, in block order.

    Parameters
    ----------
    blocks : mapping of kind to (n, k) int
        Kinds "tetra" (k = 4), "hexahedron" (8), "wedge" (6), "pyramid" (5), "pentagonal prism" (10),
        "hexagonal prism" (12); point numbers in VTK order (a wedge's first triangle is counter-clockwise
        from outside). Repeated nodes are kept: ``Mesh.from_polyhedra`` drops faces without area. A
        hexahedron with five equal nodes at the end is a tetrahedron, as in LS-DYNA.

    Raises
    ------
    MeshError
        For an unknown kind or a wrong column count.

    Examples
    --------
    >>> polyhedra_from_elements({"tetra": [[0, 1, 2, 3]]}).vertices.reshape(4, 3).tolist()
    [[0, 1, 3], [1, 2, 3], [2, 0, 3], [0, 2, 1]]
    """
    return concatenate(_block(kind, cells) for kind, cells in blocks.items())


def _block(kind: str, cells: ArrayLike) -> Polyhedra:
    """Convert elements of one type to polyhedra, and collapsed hexahedra to tetrahedra."""
    if kind not in _FACES:
        raise MeshError(f"unknown element {kind!r}; known: {', '.join(_FACES)}")
    table, nodes = _FACES[kind], np.asarray(cells, dtype=np.int64)
    if nodes.ndim != 2 or nodes.shape[1] != CORNERS[kind]:
        raise MeshError(f"{kind} cells must have shape (n, {CORNERS[kind]}), not {nodes.shape}")
    if kind == "hexahedron":
        tetra = (nodes[:, 4:] == nodes[:, 3:4]).all(axis=1)
        if tetra.any():
            nodes = np.where(tetra[:, None], nodes[:, _FOLDED_TETRA], nodes)
    n, local = len(nodes), np.concatenate([np.asarray(face) for face in table])
    ends = np.cumsum([len(face) for face in table])
    loop_offsets = np.zeros(n * len(table) + 1, np.int64)
    np.add.outer(np.arange(n) * len(local), ends, out=loop_offsets[1:].reshape(n, len(table)))
    return Polyhedra(
        frozen_int(np.arange(n + 1) * len(table)),
        frozen_int(loop_offsets),
        frozen_int(nodes.take(local, axis=1).ravel()),
    )


def concatenate(parts: Iterable[Polyhedra]) -> Polyhedra:
    """Concatenate several arrays of polyhedra."""
    solids = list(parts)
    if len(solids) == 1:
        return solids[0]
    return Polyhedra(
        _join_offsets([part.cell_offsets for part in solids]),
        _join_offsets([part.loop_offsets for part in solids]),
        frozen_int(np.concatenate([np.empty(0, np.int64), *(part.vertices for part in solids)])),
    )


def take_cells(polyhedra: Polyhedra, cells: Int) -> Polyhedra:
    """Return the selected polyhedra in the given order."""
    cell_offsets, loops = gather(polyhedra.cell_offsets, cells)
    loop_offsets, places = gather(polyhedra.loop_offsets, loops)
    return Polyhedra(cell_offsets, loop_offsets, frozen_int(polyhedra.vertices[places]))


def gather(offsets: Int, rows: Int) -> tuple[Int, Int]:
    """Return the offsets of selected CSR rows, and the indices of their entries in the old arrays."""
    sizes = offsets[rows + 1] - offsets[rows]
    new = np.concatenate(([0], np.cumsum(sizes)))
    return frozen_int(new), frozen_int(np.arange(new[-1]) + np.repeat(offsets[rows] - new[:-1], sizes))


def turns_as_listed(first: Int, second: Int, own: Mask, turns: Int, ranks: Int) -> Int:
    """Return for each cell the first rotation in which its faces have the element's order, or −1.

    A rotation is a renumbering of the corners that maps the element to itself. A cell has −1 if no rotation
    fits.

    Parameters
    ----------
    first, second : (n, F) int
        Local corners (of k) that begin each face of a cell.
    own : (n, F) bool
        True if the cell owns the face; other faces may come in any order.
    turns : (T, k) int
        Corner permutations.
    ranks : (8, 8) int
        Face of the element that begins with two corners, or −1.
    """
    from agglo_core.mesh.kernels.solid_cells import first_turns

    places = frozen_int(np.argsort(turns, axis=1))
    return frozen_int(first_turns(first, second, own, places, ranks))


def _join_offsets(parts: list[Int]) -> Int:
    sizes = np.concatenate([np.empty(0, np.int64), *(np.diff(part) for part in parts)])
    return frozen_int(np.concatenate(([0], np.cumsum(sizes))))
