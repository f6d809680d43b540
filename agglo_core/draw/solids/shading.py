"""Shading of visible surfaces: light, part outlines, cell edges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, Mask
from agglo_core.draw.colours import INK, rgb
from agglo_core.draw.solids.surfaces import Sight, Surface

_DARKEST = 0.5
"""Brightness of faces without direct light."""
_CREASE = 0.8  # cosine of the smallest crease angle drawn as a line
_ROOM = 5.0  # minimum face size in pixels for cell outlines


def brightness(surface: Surface, sight: Sight) -> Float:
    """Return the brightness of each face ``(f,)``, 0.5 to 1, with light from above and left of the viewer."""
    left = np.cross(sight.eye, np.array([0.0, 0.0, 1.0]))
    light = 2.0 * sight.eye + 0.8 * left / max(float(np.linalg.norm(left)), 1e-9) + np.array([0.0, 0.0, 1.6])
    facing: Float = surface.normals @ (light / np.linalg.norm(light))
    bright: Float = _DARKEST + (1.0 - _DARKEST) * np.maximum(facing, 0.0)
    return bright


def shade_faces(surface: Surface, sight: Sight, colours: Float, fine: int = 1) -> NDArray[np.uint8]:
    """Return a picture of visible faces in ``colours (f, 3)``, as RGBA bytes ``(height, width, 4)``.

    Parts have dark outlines, edges and steps of a part lighter lines, and cells faint lines if large enough.
    Lines are ``fine`` pixels wide.
    """
    faces, is_covered = sight.faces, sight.faces >= 0
    picture: Float = (colours * brightness(surface, sight)[:, None])[faces]
    outlines = _widen_lines(_changes(np.append(surface.parts, -1)[faces]), fine)
    if np.sqrt(is_covered.sum() / max(1, len(np.unique(faces)))) > _ROOM * fine:
        picture[_changes(faces) & is_covered] *= 0.8
    picture[_steps(surface, sight) & is_covered] *= 0.6
    picture[outlines] = rgb(INK)
    pixels: Float = np.concatenate((picture, (is_covered | outlines)[..., None]), axis=2)
    rgba: NDArray[np.uint8] = np.rint(255.0 * np.clip(pixels, 0.0, 1.0)).astype(np.uint8)
    return rgba


def _changes(numbers: Int) -> Mask:
    """Mark pixels whose value differs from that of the next pixel to the right or below."""
    changes = np.zeros(numbers.shape, bool)
    changes[:, :-1] |= numbers[:, :-1] != numbers[:, 1:]
    changes[:-1] |= numbers[:-1] != numbers[1:]
    return changes


def _steps(surface: Surface, sight: Sight) -> Mask:
    """Mark pixels between two faces that differ much in direction or in depth."""
    normals = np.concatenate((surface.normals, np.zeros((1, 3))))
    slope = np.append(1.0 / np.clip(surface.normals @ sight.eye, 0.1, None), 0.0)
    steps = np.zeros(sight.faces.shape, bool)
    for first, second in (
        ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
        ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
    ):
        a, b = sight.faces[first], sight.faces[second]
        with np.errstate(invalid="ignore"):  # both outside
            behind = np.abs(sight.depth[first] - sight.depth[second]) > 2.0 * (slope[a] + slope[b])
        turned = np.einsum("ijk,ijk->ij", normals[a], normals[b]) < _CREASE
        steps[first] |= (a != b) & (behind | turned)
    return steps


def _widen_lines(lines: Mask, width: int) -> Mask:
    """Widen one-pixel lines to ``width`` pixels."""
    wide = lines.copy()
    for k in range(1, width):
        wide[k:] |= lines[:-k]
        wide[:, k:] |= lines[:, :-k]
    return wide
