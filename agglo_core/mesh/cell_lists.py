"""Cells of a mesh as sequences of vertex loops, without a Python object per cell."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from operator import index
from typing import Any

from agglo_core.arrays import Int
from agglo_core.mesh.derived import Derived


class CellList(Sequence[Any]):
    """Read-only sequence of the cells of a mesh, which computes each cell on access from arrays."""

    def __init__(self, n_cells: int) -> None:
        self._n = n_cells

    def __len__(self) -> int:
        return self._n

    def __getitem__(self, place: int | slice) -> Any:
        if isinstance(place, slice):
            return [self._cell(c) for c in range(*place.indices(self._n))]
        c = index(place)
        if not -self._n <= c < self._n:
            raise IndexError(f"cell {c} is out of range: the mesh has {self._n} cells")
        return self._cell(c % self._n)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._n} cells)"

    @abstractmethod
    def _cell(self, c: int) -> Any:
        """Return the vertices of cell c, a number from 0 to n_cells - 1."""


class PolygonList(CellList):
    """Polygons of a 2-D mesh: cell c has the vertices ``vertices[offsets[c]:offsets[c + 1]]``."""

    def __init__(self, offsets: Int, vertices: Int) -> None:
        super().__init__(len(offsets) - 1)
        self._offsets, self._vertices = offsets, vertices

    def _cell(self, c: int) -> Int:
        return self._vertices[self._offsets[c] : self._offsets[c + 1]]


class PolyhedronList(CellList):
    """Polyhedra of a 3-D mesh, each a list of faces that are counter-clockwise from outside."""

    def __init__(self, mesh: Derived) -> None:
        super().__init__(mesh.n_cells)
        self._starts, self._faces = mesh.cell_faces
        self._owners = mesh.face_cells[:, 0]
        self._offsets, self._vertices = mesh.face_offsets, mesh.face_vertices

    def _cell(self, c: int) -> list[Int]:
        loops = []
        for f in self._faces[self._starts[c] : self._starts[c + 1]].tolist():
            loop = self._vertices[self._offsets[f] : self._offsets[f + 1]]
            # Loops are stored counter-clockwise from outside their owner.
            loops.append(loop if self._owners[f] == c else loop[::-1])
        return loops
