"""Boundary refinement: the paper's "adjust partition"."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Int, UInt64, frozen_int
from agglo_core.errors import OptionError
from agglo_core.graph import Graph
from agglo_core.protocols import Target


def checked_floor(refiner: str, floor: float) -> float:
    """The least share of its measure that ``refiner`` leaves to a part, once it is a number in [0, 1]."""
    number = isinstance(floor, int | float | np.number) and not isinstance(floor, bool)
    if not number or not 0.0 <= floor <= 1.0:
        raise OptionError(f"{refiner}: floor must be a number in [0, 1], not {floor!r}")
    return float(floor)


class InterfaceRefiner:
    """Moves cells to the part with which they share more interface; the total length never grows.

    Bounded sweeps over the boundary cells, ordered by projection on an axis of the block, so the
    result does not depend on cell numbering: first single cells, then pairs of neighbours where
    neither move pays alone. No part is emptied or disconnected, and none
    falls below ``floor`` times its mass at entry (of two sides: the smaller side's).

    Parameters
    ----------
    floor : float in [0, 1]

    Raises
    ------
    OptionError
        If ``floor`` is anything else.

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
        self.floor = checked_floor("interface", floor)

    def refine(self, graph: Graph, labels: Int, seeds: UInt64, target: Target) -> Int:
        """Labels ``(n,)`` after the sweeps; seeds and target are not used."""
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
