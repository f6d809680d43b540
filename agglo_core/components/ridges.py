"""Rules at the boundary: what lies on edges and corners of the domain keeps to itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agglo_core.arrays import Int, Mask
from agglo_core.components.regions import Regions, beside
from agglo_core.errors import OptionError
from agglo_core.graph import Graph
from agglo_core.mesh import Mesh

__all__ = ["Ridges"]


class Ridges:
    """Cells are joined only with cells that touch the same boundary patches; those at corners not at all.

    A patch is a face tag on outer faces, each of its values but zero for itself. Cells on three or more
    patches in 3-D, two in 2-D, lie at a corner and stay single; on two patches in 3-D they lie on a ridge.
    Source: Nishikawa, Diskin and Thomas, "Critical study of agglomerated multigrid methods for diffusion"
    (AIAA J. 48, 2010), hierarchical agglomeration.

    Parameters
    ----------
    tags : tuple of str
        Face tags that mark patches; all of the mesh if none is given.
    """

    def __init__(self, tags: tuple[str, ...] = ()) -> None:
        self.tags = tuple(tags)

    def for_mesh(self, mesh: Mesh) -> BoundaryClasses:
        """The rules on this mesh; an OptionError if it has no patches."""
        touched = _patches_of_cells(mesh, self.tags or tuple(mesh.face_tags))
        classes = np.unique(touched, axis=0, return_inverse=True)[1].reshape(-1)
        return BoundaryClasses(classes, touched.sum(axis=1) >= mesh.dim)


@dataclass(frozen=True)
class BoundaryClasses:
    """Cells of different classes are not joined, and those at corners not at all."""

    classes: Int
    corner: Mask

    def forbidden(self, graph: Graph) -> Mask:
        """Entries of the graph ``(m,)`` between classes, or beside a corner."""
        mask: Mask = Regions(values=self.classes).forbidden(graph) | beside(graph, self.corner)
        return mask


def _patches_of_cells(mesh: Mesh, tags: tuple[str, ...]) -> Mask:
    """Whether each cell touches each patch ``(n, patches)``."""
    missing = [tag for tag in tags if tag not in mesh.face_tags]
    if missing or not tags:
        known = ", ".join(mesh.face_tags) or "none"
        what = f"no face tag is named {missing[0]!r}" if missing else "the mesh has no boundary patches"
        raise OptionError(f"ridges: {what}; face tags: {known}")
    outer = np.flatnonzero(mesh.face_cells[:, 1] < 0)
    cells = mesh.face_cells[outer, 0]
    columns = []
    for tag in tags:
        values = mesh.face_tags[tag][outer]
        for value in np.unique(values[values != 0]):
            touched = np.zeros(mesh.n_cells, bool)
            touched[cells[values == value]] = True
            columns.append(touched)
    if not columns:
        raise OptionError(f"ridges: no outer face has one of the tags {', '.join(tags)}")
    return np.stack(columns, axis=1)
