"""Text label placement beside the dots of a scatter plot, without overlaps."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float

_TURNS: Final = (0, 12, 4, 20, 8, 16, 2, 22, 10, 14, 6, 18, 1, 23, 11, 13, 3, 21, 9, 15, 5, 19, 7, 17)
"""Directions in 1/24 turns: beside the dot first, then diagonal, above and below."""
_ATTEMPTS: Final = 8  # number of orders to try
_FAR: Final = 0.4  # maximum distance of a label, relative to the picture size


def label_places(dots: Float, sizes: Float, frame: Float, gap: float, lines: Float | None = None) -> Float:
    """Return the lower left corner ``(n, 2)`` of each label, as near to its dot as possible.

    Labels are placed one by one, beginning with the most crowded dots. Each takes the nearest place in the
    frame that overlaps no dot, line or label, or else the place with least overlap. Other orders are tried if
    overlaps remain.

    Parameters
    ----------
    dots : (n, 2) float
    sizes : (n, 2) float
        Width and height per label.
    frame : (2,) float
        Picture width and height, with lower left corner 0.
    gap : float
        Dot radius, and distance between objects.
    lines : (m, 4) float, optional
        Further boxes to avoid, by lower left and upper right corner.
    """
    least, best = np.inf, np.zeros((len(dots), 2))
    for order in _orders(dots):
        found, shared = _place_in_order(order, dots, sizes, np.asarray(frame), gap, lines)
        if shared < least or not np.isfinite(least):
            least, best = shared, found
        if least == 0.0:
            break
    return frozen_float(best)


def overlaps(boxes: Float, others: Float) -> Float:
    """Return for each box in ``(n, 4)`` the total area of its intersections with the others ``(m, 4)``.

    A box is given by its lower left and upper right corner.
    """
    ends = np.minimum(boxes[:, None, 2:], others[:, 2:])
    sides = np.maximum(ends - np.maximum(boxes[:, None, :2], others[:, :2]), 0.0)
    area: Float = sides.prod(axis=2).sum(axis=1)
    return area


def stair_boxes(corners: Float, width: float) -> Float:
    """Return narrow boxes ``(n - 1, 4)`` around the segments between successive corners ``(n, 2)``."""
    low, high = np.minimum(corners[:-1], corners[1:]), np.maximum(corners[:-1], corners[1:])
    return frozen_float(np.concatenate([low - width / 2, high + width / 2], axis=1))


def ties(dots: Float, sizes: Float, places: Float, gap: float) -> dict[int, Float]:
    """Return the end of the connecting line at each label that needs a line to its dot.

    A line is needed if a label is far from its dot, or almost as near to another dot.
    """
    line_ends = {}
    for label, (place, size) in enumerate(zip(places, sizes, strict=True)):
        ends = np.clip(dots, place, place + size)
        distances = np.linalg.norm(ends - dots, axis=1)
        other_distances = np.delete(distances, label)
        if distances[label] > 2.2 * gap or other_distances.min(initial=np.inf) < distances[label] + 1.5 * gap:
            line_ends[label] = ends[label]
    return line_ends


def _orders(dots: Float) -> Iterator[Int]:
    """Yield orders in which to place labels: most crowded dots first, then at random."""
    away = np.linalg.norm(dots[:, None] - dots[None, :], axis=2)
    nearness = (1.0 / (away + 1e-3 * (away.max(initial=0.0) or 1.0))).sum(axis=1)
    first = np.argsort(-nearness, kind="stable")
    yield first
    rng = np.random.default_rng(0)
    for _ in range(_ATTEMPTS - 1):
        yield rng.permutation(first)


def _place_in_order(
    order: Int, dots: Float, sizes: Float, frame: Float, gap: float, lines: Float | None
) -> tuple[Float, float]:
    """Place labels one by one in the given order. Return their corners and the total overlap."""
    circles = np.concatenate([dots - gap, dots + gap], axis=1)
    obstacles = circles if lines is None else np.concatenate([circles, lines])
    labels, corners, total = np.empty((0, 4)), np.zeros((len(dots), 2)), 0.0
    for i in order:
        is_distinct = np.linalg.norm(dots - dots[i], axis=1) > 2.2 * gap  # ignore coinciding dots
        line_obstacles = np.concatenate([circles[is_distinct], labels])
        corners[i], shared = _corner(dots[i], sizes[i], frame, (obstacles, line_obstacles), gap)
        total += shared
        box = np.concatenate([corners[i], corners[i] + sizes[i]])
        obstacles = np.concatenate([obstacles, box[None], _thread(dots[i], box, gap)])
        labels = np.concatenate([labels, box[None]])
    return corners, total


def _thread(dot: Float, box: Float, gap: float) -> Float:
    """Return small boxes ``(n, 4)`` that cover the line from a dot to its label."""
    end = np.clip(dot, box[:2], box[2:])
    beads = max(1, round(float(np.linalg.norm(end - dot)) / (0.5 * gap)))
    way = dot + np.linspace(0.0, 1.0, beads + 1)[1:, None] * (end - dot)
    return np.concatenate([way - 0.1 * gap, way + 0.1 * gap], axis=1)


def _corner(
    dot: Float, size: Float, frame: Float, obstacles: tuple[Float, Float], gap: float
) -> tuple[Float, float]:
    """Return the lower left corner of the best place for one label, and its overlap with obstacles.

    ``obstacles`` are the boxes to avoid by the label, and by the line to the label.
    """
    boxes = _candidates(dot, size, gap, _FAR * float(frame.max()))
    boxes = boxes[(boxes[:, :2] >= 0.0).all(axis=1) & (boxes[:, 2:] <= frame).all(axis=1)]
    shared = 1e3 * overlaps(boxes, obstacles[0])  # overlapping labels are worse than lines across labels
    best, least = dot, np.inf
    for place in np.argsort(shared, kind="stable"):
        if shared[place] >= least:
            break
        overlap = float(shared[place] + overlaps(_thread(dot, boxes[place], gap), obstacles[1]).sum())
        if overlap < least:
            best, least = boxes[place, :2], overlap
    return best, least


def _candidates(dot: Float, size: Float, gap: float, max_radius: float) -> Float:
    """Return possible boxes ``(n, 4)`` for a label, in rings of growing radius around its dot."""
    angles = np.pi * np.array(_TURNS) / 12.0
    ways = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    rings = np.arange(1.5 * gap, max_radius, gap)[:, None, None]
    middles = (dot + rings * ways + 0.5 * size * np.clip(1.5 * ways, -1.0, 1.0)).reshape(-1, 2)
    return np.concatenate([middles - 0.5 * size, middles + 0.5 * size], axis=1)
