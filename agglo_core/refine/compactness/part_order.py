"""Coordinates of part centres along an axis of their block, which order the parts geometrically."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.refine.compactness.state import CENTRE, MASS

_FLAT = 1e-6
"""Relative tolerance for vanishing moments.

A third moment below this fraction of its scale, (Σ m r²)^1.5 / (Σ m)^0.5, is rounding. So is a second moment
across an axis below this fraction of the moment along it.
"""


@helper(allocates=True)
def _block_centres(block, count, tally):
    """Return the centre ``(count, 3)`` and the mass (at least 1e-300) per block."""
    mass, centres = np.zeros(count), np.zeros((count, 3))
    for p in range(len(block)):
        b, m = block[p], tally[p, MASS]
        mass[b] += m
        for a in range(3):
            centres[b, a] += m * tally[p, CENTRE + a]
    for b in range(count):
        mass[b] = max(mass[b], 1e-300)
        for a in range(3):
            centres[b, a] /= mass[b]
    return centres, mass


@kernel
def part_places(block, count, tally):
    """Return the block axes ``(count, 3)`` and the coordinates ``(k,)`` of the part centres along them.

    An axis is the third moment Σ m |r|² r of the part centres about the block centre. It rotates with the
    block, and vanishes only by symmetry. A fixed direction then replaces it.
    """
    centres, mass = _block_centres(block, count, tally)
    inertia, axes, extent = np.zeros(count), np.zeros((count, 3)), 0.0
    # 1. Scale lengths by the extent of all centres, so that their cubes are finite.
    for p in range(len(block)):
        for a in range(3):
            extent = max(extent, abs(tally[p, CENTRE + a] - tally[0, CENTRE + a]))
    unit = 1.0 / extent if extent > 1e-300 else 1.0
    # 2. Compute the second moment Σ m |r|² and the third moment Σ m |r|² r of each block.
    for p in range(len(block)):
        b, square = block[p], 0.0
        for a in range(3):
            square += (unit * (tally[p, CENTRE + a] - centres[b, a])) ** 2
        square *= tally[p, MASS]
        inertia[b] += square
        for a in range(3):
            axes[b, a] += square * (unit * (tally[p, CENTRE + a] - centres[b, a]))
    for b in range(count):
        # 3. If symmetry leaves only rounding in the third moment (or zero, or NaN), use a fixed direction
        #    along no axis or diagonal.
        length, bound = 0.0, inertia[b] * np.sqrt(inertia[b] / mass[b])
        for a in range(3):
            length += axes[b, a] ** 2
        if not np.sqrt(length) > _FLAT * bound:
            for a in range(3):
                axes[b, a] = 1.0 / (1.0 + np.sqrt(2.0) * a)
    # 4. Project the centres onto these axes, which need not have unit length.
    places = np.zeros(len(block))
    for p in range(len(block)):
        for a in range(3):
            places[p] += axes[block[p], a] * tally[p, CENTRE + a]
    return axes, places


@helper(allocates=True)
def _across(block, tally, axes, centres, mass, dim):
    """Return a direction perpendicular to each block's axis ``(count, 3)``: see :func:`places_across`."""
    count = len(axes)
    unit, across = np.zeros((count, 3)), np.zeros((count, 3))
    # 1. Unit vectors u along the axes.
    for b in range(count):
        length = 0.0
        for a in range(dim):
            length += axes[b, a] ** 2
        for a in range(dim):
            unit[b, a] = axes[b, a] / np.sqrt(length)
    # 2. Compute M u, with the second moments M = Σ m r rᵀ / Σ m of the part centres.
    for p in range(len(block)):
        b, projection = block[p], 0.0
        for a in range(dim):
            projection += (tally[p, CENTRE + a] - centres[b, a]) * unit[b, a]
        for a in range(dim):
            across[b, a] += tally[p, MASS] * projection * (tally[p, CENTRE + a] - centres[b, a]) / mass[b]
    # 3. Take the component perpendicular to u. If u is nearly an eigenvector, this is rounding: then rotate u
    #    by 90° in the xy-plane.
    for b in range(count):
        length, rayleigh = 0.0, 0.0
        for a in range(dim):
            rayleigh += across[b, a] * unit[b, a]
        for a in range(dim):
            across[b, a] -= rayleigh * unit[b, a]
            length += across[b, a] ** 2
        if not np.sqrt(length) > _FLAT * rayleigh:
            across[b, 0], across[b, 1], across[b, 2] = -unit[b, 1], unit[b, 0], 0.0
    return across


@kernel
def places_across(block, tally, axes, dim):
    """Return the coordinate ``(k,)`` of each part's centre perpendicular to the axis of its block.

    The direction follows from the second moments and the axis. If symmetry leaves it undefined, a direction
    that rotates with the block in the plane replaces it.
    """
    places = np.zeros(len(block))
    centres, mass = _block_centres(block, len(axes), tally)
    across = _across(block, tally, axes, centres, mass, dim)
    for p in range(len(block)):
        b = block[p]
        for a in range(dim):
            places[p] += (tally[p, CENTRE + a] - centres[b, a]) * across[b, a]
    return places
