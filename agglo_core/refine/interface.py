"""Boundary refinement: move cells to shorten interfaces ("adjust partition" in the paper)."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Int, UInt64, frozen_int
from agglo_core.errors import OptionError
from agglo_core.graph import Graph
from agglo_core.protocols import Target


def check_floor(refiner: str, floor: float) -> float:
    """Check that ``floor`` is a number in [0, 1].

    ``floor`` is the smallest fraction of its measure that ``refiner`` leaves to a part.
    """
    number = isinstance(floor, int | float | np.number) and not isinstance(floor, bool)
    if not number or not 0.0 <= floor <= 1.0:
        raise OptionError(f"{refiner}: floor must be a number in [0, 1], not {floor!r}")
    return float(floor)


class InterfaceRefiner:
    """Move cells to the part with the longer common interface.

    The total length never increases. Bounded sweeps visit the boundary cells, ordered by projection on an
    axis of the block, so the result does not depend on cell numbering. First single cells move, then pairs of
    adjacent cells if neither move pays alone. No part is emptied or disconnected, and no part falls below
    ``floor`` times its mass at entry (for two sides: times the smaller side's mass).

    Parameters
    ----------
    floor : float in [0, 1]

    Raises
    ------
    OptionError
        If ``floor`` is not a number in [0, 1].

    Examples
    --------
    >>> from agglo_core.authoring import InterfaceRefiner, Target
    >>> strip = agglo.samples.strip(6).graph
    >>> labels = np.array([0, 1, 0, 0, 1, 1])
    >>> InterfaceRefiner(floor=0.5).refine(strip, labels, np.zeros(1, np.uint64), Target(parts=2))
    array([0, 0, 0, 0, 1, 1])
    """

    objective = "interface"

    def __init__(self, floor: float = 0.85) -> None:
        self.floor = check_floor("interface", floor)

    def refine(self, graph: Graph, labels: Int, seeds: UInt64, target: Target) -> Int:
        """Return the labels ``(n,)`` after the sweeps, independent of seeds and target."""
        from agglo_core.refine.interface_kernels import relax_interface

        return frozen_int(
            relax_interface(
                graph.offsets,
                graph.indptr,
                graph.indices,
                graph.interface,
                graph.centroids,
                graph.mass,
                frozen_int(labels),
                self.floor,
            )
        )
