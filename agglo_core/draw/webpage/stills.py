"""Pictures of a 3-D mesh for the report, from fixed directions: cell and brightness at each pixel."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from agglo_core.arrays import Int
from agglo_core.draw.solids.shading import brightness
from agglo_core.draw.solids.surfaces import SIDE, Surface, mark_cells_beyond, outer_faces, project_surface
from agglo_core.draw.webpage.packing import integers
from agglo_core.mesh import Mesh

_PIXELS, _PIXELS_APART = 720, 600  # longer side of the pictures in pixels
_EXPLODE = 0.35  # explosion of agglomerates
_SIDES: Final = {
    "from +x −y, above": SIDE,
    "from +x +y, above": (30.0, 30.0),
    "from −x +y, above": (120.0, 30.0),
    "from −x −y, above": (210.0, 30.0),
    "from +x −y, below": (-60.0, -35.0),
}
_CUTS: Final = {
    "cut open across x": ((1.0, 0.0, 0.0), (-35.0, 25.0)),
    "cut open across y": ((0.0, -1.0, 0.0), (-60.0, 25.0)),
    "cut open across z": ((0.0, 0.0, 1.0), (-60.0, 55.0)),
}
"""Normal of the cut (the half beyond is left out), and direction of the eye."""


def stills(mesh: Mesh, order: Int) -> list[dict[str, Any]]:
    """Return pictures of a 3-D mesh from five directions, and cut open along three planes.

    Cells are identified by their indices in ``order``. All levels use these pictures.
    """
    places = _places(order)
    labels = np.zeros(mesh.n_cells, np.int64)
    whole = outer_faces(mesh, labels)
    pictures = [_still(name, whole, side, _PIXELS, places) for name, side in _SIDES.items()]
    for name, (normal, side) in _CUTS.items():
        pictures.append(
            _still(
                name, outer_faces(mesh, labels, kept=~mark_cells_beyond(mesh, normal)), side, _PIXELS, places
            )
        )
    return pictures


def exploded_still(mesh: Mesh, labels: Int, order: Int) -> dict[str, Any]:
    """Return a picture of a 3-D mesh with parts moved apart."""
    faces = outer_faces(mesh, labels, _EXPLODE)
    return _still("moved apart", faces, SIDE, _PIXELS_APART, _places(order))


def _places(order: Int) -> Int:
    places = np.empty_like(order)
    places[order] = np.arange(len(order))
    return places


def _still(
    name: str, surface: Surface, side: tuple[float, float], pixels: int, places: Int
) -> dict[str, Any]:
    """Return a picture as run lengths, row by row: index of the visible face (0 for none), and length.

    For face number k + 1, entry k of ``cells`` and ``bright`` is its cell and brightness (255 is full).
    """
    sight = project_surface(surface, side, pixels)
    faces, numbers = np.unique(np.append(sight.faces.ravel(), -1), return_inverse=True)
    numbers = numbers[:-1]  # face −1, always present, became 0
    starts = np.flatnonzero(np.append(True, numbers[1:] != numbers[:-1]))
    bright = brightness(surface, sight)[faces[1:]]
    return {
        "name": name,
        "height": sight.faces.shape[0],
        "width": sight.faces.shape[1],
        "faces": integers(numbers[starts]),
        "lengths": integers(np.diff(np.append(starts, len(numbers)))),
        "cells": integers(places[surface.cells[faces[1:]]]),
        "bright": integers(np.rint(255.0 * bright)),
    }
