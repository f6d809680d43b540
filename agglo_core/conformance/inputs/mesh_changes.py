"""Geometric transformations and renumberings of 2-D and 3-D meshes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from agglo_core.arrays import Float, Int, frozen_int, trusted_copy
from agglo_core.mesh import Mesh


@dataclass(frozen=True)
class Change:
    """Geometric transformation: reflection, rotation, shift and scaling, in this order.

    Attributes
    ----------
    turned, mirror : bool
        Apply the rotation or the reflection.
    away : float
        Shift length, in mesh diameters.
    scale : float
        Scale factor.
    """

    turned: bool = False
    mirror: bool = False
    away: float = 0.0
    scale: float = 1.0

    def points(self, mesh: Mesh) -> Float:
        """Return a mesh's transformed points ``(n_points, d)``."""
        points, d = mesh.points, mesh.dim
        if self.mirror:
            points = points * np.array([-1.0, 1.0, 1.0][:d])
        if self.turned:
            points = points @ _ROTATION[d]
        direction = np.array([0.8, -0.6, 0.5][:d])
        diameter = float(np.linalg.norm(np.ptp(mesh.points, axis=0)))
        return np.asarray(self.scale * (points + self.away * diameter * direction))


def _rotations() -> Mapping[int, Float]:
    cos, sin = np.cos(0.7), np.sin(0.7)
    plane = np.array([[cos, sin], [-sin, cos]])
    about_z, about_x = np.eye(3), np.eye(3)
    about_z[:2, :2], about_x[1:, 1:] = plane, plane
    return {2: plane, 3: about_z @ about_x}


_ROTATION = _rotations()

MOTIONS: Mapping[str, Change] = {
    "rotated": Change(turned=True),
    "mirrored": Change(mirror=True),
    "shifted by a million diameters": Change(away=1e6),
}
"""Rigid motions by name."""


def transform_mesh(mesh: Mesh, change: Change) -> Mesh:
    """Apply a geometric transformation to the points of a mesh.

    Cells and points keep their numbers and tags.
    """
    moved_mesh = trusted_copy(mesh, points=change.points(mesh))  # inside out until the faces are reversed
    return reverse_faces(moved_mesh) if change.mirror else moved_mesh


def reverse_faces(mesh: Mesh) -> Mesh:
    """Return the mesh with reversed vertex order in each face, as required after a reflection."""
    backwards = [face[::-1] for face in np.split(mesh.face_vertices, mesh.face_offsets[1:-1])]
    return replace(mesh, face_vertices=np.concatenate(backwards))


def renumber_mesh(mesh: Mesh, seed: int = 5) -> tuple[Mesh, Int]:
    """Renumber the cells, faces and points of a mesh at random.

    Return the mesh and the old index per cell.
    """
    rng = np.random.default_rng(seed)
    # Map old to new cell indices; -1 marks the outside and stays.
    cells, faces, points = (rng.permutation(n) for n in (mesh.n_cells, mesh.n_faces, mesh.n_points))
    new_cell = np.append(np.argsort(cells), -1)
    loops = np.split(np.argsort(points)[mesh.face_vertices], mesh.face_offsets[1:-1])
    sizes = np.diff(mesh.face_offsets)[faces]
    renumbered_mesh = Mesh(
        mesh.points[points],
        np.concatenate(([0], np.cumsum(sizes))),
        np.concatenate([loops[face] for face in faces]),
        new_cell[mesh.face_cells[faces]],
        cell_tags={name: tag[cells] for name, tag in mesh.cell_tags.items()},
        face_tags={name: tag[faces] for name, tag in mesh.face_tags.items()},
        name=mesh.name,
    )
    return renumbered_mesh, frozen_int(cells)


def turn_inner_faces(mesh: Mesh, seed: int = 7) -> Mesh:
    """Reverse about half of the inner faces of a mesh, and swap the two cells of these faces."""
    inner = mesh.face_cells[:, 1] >= 0
    turned = inner & (np.random.default_rng(seed).random(mesh.n_faces) < 0.5)
    loops = np.split(mesh.face_vertices, mesh.face_offsets[1:-1])
    return replace(
        mesh,
        face_vertices=np.concatenate(
            [loop[::-1] if over else loop for loop, over in zip(loops, turned, strict=True)]
        ),
        face_cells=np.where(turned[:, None], mesh.face_cells[:, ::-1], mesh.face_cells),
    )
