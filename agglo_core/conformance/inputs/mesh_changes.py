"""Changes of 2-D and 3-D meshes: motions, other numbers, other faces, and cells left out or added."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.mesh import Mesh


def _rotations() -> Mapping[int, Float]:
    cos, sin = np.cos(0.7), np.sin(0.7)
    plane = np.array([[cos, sin], [-sin, cos]])
    about_z, about_x = np.eye(3), np.eye(3)
    about_z[:2, :2], about_x[1:, 1:] = plane, plane
    return {2: plane, 3: about_z @ about_x}


_ROTATION = _rotations()

MOTIONS: Mapping[str, Mapping[str, Any]] = {
    "rotated": {"turned": True},
    "mirrored": {"mirror": True},
    "shifted by a million diameters": {"away": 1e6},
}
"""Rigid motions by name: arguments of :func:`transform_mesh`."""


def transform_mesh(
    mesh: Mesh, *, mirror: bool = False, turned: bool = False, away: float = 0.0, scale: float = 1.0
) -> Mesh:
    """Reflect, rotate, shift by ``away`` mesh diameters and scale a mesh, in this order.

    Cells and points keep their numbers and tags.
    """
    points, faces, d = mesh.points, mesh.face_vertices, mesh.dim
    if mirror:  # the vertices of each face are reversed, because a reflection turns the mesh inside out
        points = points * np.array([-1.0, 1.0, 1.0][:d])
        faces = np.concatenate([loop[::-1] for loop in _loops(mesh)])
    if turned:
        points = points @ _ROTATION[d]
    direction = np.array([0.8, -0.6, 0.5][:d])
    diameter = float(np.linalg.norm(np.ptp(mesh.points, axis=0)))
    return replace(mesh, points=scale * (points + away * diameter * direction), face_vertices=faces)


def renumber_mesh(mesh: Mesh, seed: int = 5) -> tuple[Mesh, Int]:
    """Renumber the cells, faces and points of a mesh at random.

    Return the mesh and the old index per cell.
    """
    rng = np.random.default_rng(seed)
    # Map old to new cell indices; -1 marks the outside and stays.
    cells, faces, points = (rng.permutation(n) for n in (mesh.n_cells, mesh.n_faces, mesh.n_points))
    new_cell = np.append(np.argsort(cells), -1)
    loops, new_point = _loops(mesh), np.argsort(points)
    renumbered = _mesh_of(
        mesh.points[points], [new_point[loops[face]] for face in faces], new_cell[mesh.face_cells[faces]]
    )
    cell_tags = {name: tag[cells] for name, tag in mesh.cell_tags.items()}
    face_tags = {name: tag[faces] for name, tag in mesh.face_tags.items()}
    return replace(renumbered, cell_tags=cell_tags, face_tags=face_tags, name=mesh.name), frozen_int(cells)


def turn_inner_faces(mesh: Mesh, seed: int = 7) -> Mesh:
    """Reverse about half of the inner faces of a mesh, and swap the two cells of these faces."""
    turned = ~mesh.outer_faces & (np.random.default_rng(seed).random(mesh.n_faces) < 0.5)
    loops = [loop[::-1] if over else loop for loop, over in zip(_loops(mesh), turned, strict=True)]
    cells = np.where(turned[:, None], mesh.face_cells[:, ::-1], mesh.face_cells)
    return replace(mesh, face_vertices=np.concatenate(loops), face_cells=cells)


def halve_faces(mesh: Mesh) -> Mesh:
    """Return the mesh with each face cut at its centre: edges into halves, and polygons into triangles."""
    loops = _loops(mesh)
    centres = np.array([mesh.points[loop].mean(axis=0) for loop in loops])
    pieces: list[Int] = []
    for centre, loop in enumerate(loops, mesh.n_points):
        if mesh.dim == 2:
            pieces += [np.array([loop[0], centre]), np.array([centre, loop[1]])]
        else:
            pieces += [np.array([a, b, centre]) for a, b in zip(loop, np.roll(loop, -1), strict=True)]
    cells = np.repeat(mesh.face_cells, [len(loop) for loop in loops], axis=0)
    return _mesh_of(np.concatenate((mesh.points, centres)), pieces, cells)


def without_cell(mesh: Mesh, cell: int) -> Mesh:
    """Return the mesh without a cell, whose faces join the boundary."""
    number = np.arange(mesh.n_cells) - (np.arange(mesh.n_cells) > cell)
    number[cell] = -1
    cells = np.append(number, -1)[mesh.face_cells]
    kept, turned = cells.max(axis=1) >= 0, (cells[:, 0] < 0) & (cells[:, 1] >= 0)
    loops = [loop[::-1] if turned[face] else loop for face, loop in enumerate(_loops(mesh)) if kept[face]]
    return _mesh_of(mesh.points, loops, np.where(turned[:, None], cells[:, ::-1], cells)[kept])


def beside(mesh: Mesh, other: Mesh) -> Mesh:
    """Return both meshes as one mesh of separate components."""
    gap = np.zeros(mesh.dim)
    gap[0] = mesh.points[:, 0].max() - other.points[:, 0].min() + np.ptp(mesh.points[:, 0]) / 3
    loops = [*_loops(mesh), *(loop + mesh.n_points for loop in _loops(other))]
    cells = np.where(other.face_cells < 0, -1, other.face_cells + mesh.n_cells)
    points = np.concatenate((mesh.points, other.points + gap))
    return _mesh_of(points, loops, np.concatenate((mesh.face_cells, cells)))


def _loops(mesh: Mesh) -> list[Int]:
    """Return the vertices of each face."""
    return np.split(mesh.face_vertices, mesh.face_offsets[1:-1])


def _mesh_of(points: Float, loops: list[Int], cells: Int) -> Mesh:
    """Return the mesh of faces given by their vertices and cells, without points that no face uses."""
    used, vertices = np.unique(np.concatenate(loops), return_inverse=True)
    offsets = np.concatenate(([0], np.cumsum([len(loop) for loop in loops])))
    return Mesh(points[used], offsets, vertices.ravel(), cells)
