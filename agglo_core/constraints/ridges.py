"""Boundary rules: join only cells on the same boundary patches, and keep corner cells apart."""

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
    """Constraint: join only cells that touch the same boundary patches, and no cells at corners.

    A patch is a set of boundary faces with equal values in all tags, at least one of them in its group. Cells
    on three or more patches in 3-D, or two in 2-D, are at a corner and stay single. Cells on two patches in
    3-D are on a ridge.
    Source: Nishikawa, Diskin and Thomas, "Critical study of agglomerated multigrid methods for diffusion"
    (AIAA J. 48, 2010), hierarchical agglomeration.

    Parameters
    ----------
    tags : tuple of str
        Face tags that mark patches, where their value is neither 0 nor −1. Default: all face tags.
    """

    def __init__(self, tags: tuple[str, ...] = ()) -> None:
        self.tags = tuple(tags)

    def for_mesh(self, mesh: Mesh) -> BoundaryClasses:
        """Return the boundary classes of the cells of a mesh, or raise OptionError without patches."""
        touched = _patches_of_cells(mesh, self.tags or tuple(mesh.face_tags))
        classes = np.unique(touched, axis=0, return_inverse=True)[1].reshape(-1)
        return BoundaryClasses(classes, touched.sum(axis=1) >= mesh.dim)


@dataclass(frozen=True)
class BoundaryClasses:
    """Constraint: cells of different boundary classes are not joined, and corner cells not at all."""

    classes: Int
    corner: Mask

    def forbidden(self, graph: Graph) -> Mask:
        """Return a mask ``(m,)`` of the dual edges between classes or at a corner cell."""
        mask: Mask = Regions(values=self.classes).forbidden(graph) | beside(graph, self.corner)
        return mask


def _patches_of_cells(mesh: Mesh, tags: tuple[str, ...]) -> Mask:
    """Return a mask ``(n, patches)`` of the boundary patches that each cell touches."""
    if not tags:
        raise OptionError(
            "ridges: the mesh has no boundary patches (face tags: none); add them with mesh.with_face_tags"
        )
    # 1. Tag values on the boundary faces, 0 outside the groups.
    outer = mesh.face_cells[:, 1] < 0
    columns = [values_of("ridges", tag, mesh.face_tags, mesh.n_faces, "face")[outer] for tag in tags]
    # Files may describe a patch by name and by numbers, so only distinct value combinations count as patches.
    values = np.stack([np.where(in_group(each), each, 0) for each in columns], axis=1)
    listed = values.any(axis=1)
    if not listed.any():
        raise OptionError(f"ridges: no outer face has one of the tags {', '.join(tags)}")
    # 2. Patches are the distinct combinations. Mark their cells.
    patches, patch = np.unique(values[listed], axis=0, return_inverse=True)
    touched = np.zeros((mesh.n_cells, len(patches)), bool)
    touched[mesh.face_cells[outer, 0][listed], patch.reshape(-1)] = True
    return touched
