"""Rules at the boundary: what lies on edges and corners of the domain keeps to itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agglo_core.arrays import Int, Mask
from agglo_core.constraints.regions import Regions, beside
from agglo_core.errors import OptionError
from agglo_core.graph import Graph
from agglo_core.mesh import Mesh
from agglo_core.mesh.marks import in_group, values_of


class Ridges:
    """Cells are joined only with cells that touch the same boundary patches; those at corners not at all.

    A patch is the outer faces that agree in all tags, and lie in the group of at least one. Cells on three
    or more patches in 3-D, two in 2-D, lie at a corner and stay single; on two patches in 3-D they lie on a
    ridge.
    Source: Nishikawa, Diskin and Thomas, "Critical study of agglomerated multigrid methods for diffusion"
    (AIAA J. 48, 2010), hierarchical agglomeration.

    Parameters
    ----------
    tags : tuple of str
        Face tags that mark patches, where they are neither 0 nor −1; all of the mesh if none is given.
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
    if not tags:
        raise OptionError("ridges: the mesh has no boundary patches; face tags: none")
    outer = mesh.face_cells[:, 1] < 0
    columns = [values_of("ridges", tag, mesh.face_tags, mesh.n_faces, "face")[outer] for tag in tags]
    # a file may describe one patch by its name and by numbers, so only combinations of values differ
    values = np.stack([np.where(in_group(each), each, 0) for each in columns], axis=1)
    listed = values.any(axis=1)
    if not listed.any():
        raise OptionError(f"ridges: no outer face has one of the tags {', '.join(tags)}")
    patches, patch = np.unique(values[listed], axis=0, return_inverse=True)
    touched = np.zeros((mesh.n_cells, len(patches)), bool)
    touched[mesh.face_cells[outer, 0][listed], patch.reshape(-1)] = True
    return touched
