"""Convert mesh structures of the MATLAB package MRST: grids G and coarse grids CG."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from agglo_core.arrays import Int, frozen_float, frozen_int
from agglo_core.errors import FileError
from agglo_core.io.matlab.mat5 import Variable
from agglo_core.io.matlab.mat5_write import numbers, structure
from agglo_core.io.to_mesh.array_checks import check_directions
from agglo_core.io.to_mesh.plain_cells import used_points
from agglo_core.mesh import Mesh
from agglo_core.mesh.elements import gather


def mesh_of_grid(grid: Variable) -> Mesh:
    """Build a mesh from MRST's grid structure G, face by face.

    Drop points without a face.

    Raises
    ------
    FileError, MeshError
        If fields are missing or do not form a mesh.
    """
    parts = grid.fields()
    nodes, faces = (
        _fields(parts, "nodes", ("coords",)),
        _fields(parts, "faces", ("nodePos", "nodes", "neighbors")),
    )
    points = nodes["coords"].reals()
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise FileError(f"G.nodes.coords has the shape {points.shape}, expected 2 or 3 columns")
    # MATLAB counts from 1, and 0 stands for the outside.
    offsets, vertices = faces["nodePos"].integers() - 1, faces["nodes"].integers() - 1
    if not len(offsets) or offsets[0] != 0 or (np.diff(offsets) < 1).any() or offsets[-1] != len(vertices):
        raise FileError(f"G.faces.nodePos must increase from 1 to {len(vertices) + 1}")
    sides = faces["neighbors"]
    if sides.shape != (len(offsets) - 1, 2):
        raise FileError(f"G.faces.neighbors has the shape {sides.shape}, expected ({len(offsets) - 1}, 2)")
    cells = frozen_int(sides.integers().reshape(2, -1).T - 1)
    if not len(cells) or cells.min() < -1 or cells.max() >= 2 * len(cells) or (cells.max(axis=1) < 0).any():
        raise FileError("G.faces.neighbors has an invalid cell number, or a face without a cell")
    if vertices.min(initial=0) < 0 or vertices.max(initial=-1) >= len(points):
        raise FileError(f"G.faces.nodes uses points outside 1..{len(points)}")
    # Drop unused points and reverse faces whose first neighbour is the outside.
    has_face = np.zeros(len(points), bool)
    has_face[vertices] = True
    turned = cells[:, 0] < 0  # the outside comes first
    mesh = Mesh(
        frozen_float(points[has_face]),
        frozen_int(offsets),
        _reverse_loops(
            frozen_int(offsets), frozen_int((np.cumsum(has_face) - 1)[vertices]), frozen_int(turned)
        ),
        frozen_int(np.where(turned[:, None], cells[:, ::-1], cells)),
    )
    check_directions(mesh)
    return mesh


def _fields(parts: Mapping[str, Variable], name: str, names: tuple[str, ...]) -> dict[str, Variable]:
    if name not in parts:
        raise FileError(f"G has no field {name!r}; it has {', '.join(parts) or 'none'}")
    fields = parts[name].fields()
    missing = [field for field in names if field not in fields]
    if missing:
        raise FileError(f"G.{name} has no field {missing[0]!r}; it has {', '.join(fields) or 'none'}")
    return fields


def _reverse_loops(offsets: Int, vertices: Int, mask: Int) -> Int:
    """Reverse the vertex order of the faces marked in ``mask``."""
    sizes = np.diff(offsets)
    place = np.arange(len(vertices))
    mirrored = np.repeat(offsets[:-1] + offsets[1:] - 1, sizes) - place
    return frozen_int(vertices[np.where(np.repeat(mask != 0, sizes), mirrored, place)])


def grid_structure(mesh: Mesh) -> bytes:
    """Return a mesh as MRST's structure G, without the fields that ``computeGeometry`` adds."""
    points, number = used_points(mesh)
    vertices = mesh.face_vertices if number is None else frozen_int(number[mesh.face_vertices])
    cell_offsets, faces = mesh.cell_faces
    order = gather(cell_offsets, frozen_int(np.arange(mesh.n_cells)))[1]
    return structure(
        "G",
        {
            "cells": structure(
                "",
                {
                    "num": numbers("", [[mesh.n_cells]]),
                    "facePos": numbers("", cell_offsets + 1),
                    "faces": numbers("", faces[order].astype(np.int64) + 1),
                },
            ),
            "faces": structure(
                "",
                {
                    "num": numbers("", [[mesh.n_faces]]),
                    "nodePos": numbers("", mesh.face_offsets + 1),
                    "nodes": numbers("", vertices + 1),
                    "neighbors": numbers("", mesh.face_cells + 1),
                },
            ),
            "nodes": structure("", {"num": numbers("", [[len(points)]]), "coords": numbers("", points)}),
            "griddim": numbers("", [[mesh.dim]]),
        },
    )


def coarse_structure(name: str, mesh: Mesh, labels: Int) -> bytes:
    """Return a labelling as MRST's coarse grid, with the fields of ``generateCoarseGrid`` except ``parent``.

    A coarse face consists of all mesh faces between the same two blocks, or between a block and the outside
    (block 0). The faces of coarse face i are ``fconn(connPos(i) : connPos(i + 1) - 1)``.
    """
    # Sort the faces between blocks by block pair, interior pairs first.
    blocks = np.where(mesh.face_cells >= 0, labels[mesh.face_cells] + 1, 0)
    block_faces = np.flatnonzero(blocks[:, 0] != blocks[:, 1])
    low, high = np.sort(blocks[block_faces], axis=1).T
    inner = low > 0
    order = np.lexsort((np.where(inner, high, 0), np.where(inner, low, high), ~inner))
    pairs = np.stack((np.where(inner, low, high), np.where(inner, high, 0)), axis=1)[order]
    # Each run of equal pairs is a coarse face.
    new = np.concatenate(([True], (np.diff(pairs, axis=0) != 0).any(axis=1)))
    starts = np.flatnonzero(new)
    neighbours = pairs[starts]
    # List the coarse faces of each block.
    face = np.repeat(np.arange(len(starts)), 2)[neighbours.ravel() > 0]
    block = neighbours.ravel()[neighbours.ravel() > 0]
    n = int(labels.max()) + 1
    ends = np.cumsum(np.bincount(block - 1, minlength=n))
    cells = {
        "num": numbers("", [[n]]),
        "facePos": numbers("", frozen_int(np.concatenate(([0], ends)) + 1)),
        "faces": numbers("", frozen_int(face[np.argsort(block, kind="stable")] + 1)),
    }
    faces = {
        "num": numbers("", [[len(starts)]]),
        "neighbors": numbers("", frozen_int(neighbours)),
        "connPos": numbers("", frozen_int(np.concatenate((starts, [len(block_faces)])) + 1)),
        "fconn": numbers("", frozen_int(block_faces[order] + 1)),
    }
    return structure(
        name,
        {
            "cells": structure("", cells),
            "faces": structure("", faces),
            "partition": numbers("", frozen_int(labels + 1)),
            "griddim": numbers("", [[mesh.dim]]),
        },
    )
