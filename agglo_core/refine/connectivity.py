"""Fixer that makes every part connected."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Int, frozen_int
from agglo_core.graph import Graph


class ConnectivityFixer:
    """Keep each part's largest component, and join the other components to adjacent parts.

    The largest component is the heaviest by mass. Each other component joins the part with the longest common
    interface. Growth starts from the kept components, so every part is connected by construction, and no
    label is created or dropped. Ties (up to rounding) are broken by the component's position, not by the cell
    numbering.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.authoring import ConnectivityFixer
    >>> graph = agglo.samples.strip(4).graph
    >>> ConnectivityFixer().fix(graph, np.array([0, 0, 1, 0]))
    array([0, 0, 1, 1])
    """

    def fix(self, graph: Graph, labels: Int) -> Int:
        """Return labels ``(n,)`` with every part connected.

        Raises
        ------
        ValueError
            If a block of ``graph`` is disconnected.
        """
        from agglo_core.refine.repair import mend_blocks

        fixed = mend_blocks(
            graph.offsets,
            graph.indptr,
            graph.indices,
            graph.interface,
            graph.centroids,
            graph.mass,
            frozen_int(labels),
            int(labels.max()) + 1,
        )
        lost = np.flatnonzero(fixed < 0)
        if len(lost):
            block = int(graph.block_ids[lost[0]])
            raise ValueError(f"block {block} is disconnected: split it into components before fixing")
        return frozen_int(fixed)
