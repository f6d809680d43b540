"""Protocols of constraints on parts: forbidden edges, admissible contents, minimum contents."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, runtime_checkable

from agglo_core.arrays import Int, Mask

if TYPE_CHECKING:
    from agglo_core.graph import Graph


@runtime_checkable
class Forbidding(Protocol):
    """Constraint that forbids edges of the graph: each part must be connected without them.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.protocols import Forbidding
    >>> class Fault:
    ...     def forbidden(self, graph):
    ...         left = graph.centroids[:, 0] < 0.0  # of the middle of the mesh
    ...         return np.repeat(left, np.diff(graph.indptr)) != left[graph.indices]
    >>> isinstance(Fault(), Forbidding), int(Fault().forbidden(agglo.samples.squares(2).graph).sum())
    (True, 4)
    """

    def forbidden(self, graph: Graph) -> Mask:
        """Return the mask ``(m,)`` of forbidden edges (CSR entries), equal for both directions of an edge.

        Parts are connected without these edges; they may reach around the end of a barrier.
        """


@runtime_checkable
class Admitting(Protocol):
    """Constraint that admits or rejects each part by its contents.

    Pieces of admissible parts must also be admissible.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.protocols import Admitting
    >>> class AtMostTwo:
    ...     def admissible(self, graph, labels):
    ...         return np.bincount(labels) <= 2
    >>> isinstance(AtMostTwo(), Admitting)
    True
    >>> AtMostTwo().admissible(agglo.samples.squares(2).graph, np.array([0, 0, 0, 1]))
    array([False,  True])
    """

    def admissible(self, graph: Graph, labels: Int) -> Mask:
        """Return the mask ``(k,)`` of admissible parts for ``labels (n,)``.

        Other parts are split.
        """


@runtime_checkable
class Completing(Protocol):
    """Constraint on the minimum contents of a part: an incomplete part should join a neighbour.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.protocols import Completing
    >>> class AtLeastTwo:
    ...     def incomplete(self, graph, labels):
    ...         return np.bincount(labels) < 2
    >>> isinstance(AtLeastTwo(), Completing)
    True
    >>> AtLeastTwo().incomplete(agglo.samples.squares(2).graph, np.array([0, 0, 0, 1]))
    array([False,  True])
    """

    def incomplete(self, graph: Graph, labels: Int) -> Mask:
        """Return the mask ``(k,)`` of parts that should join a neighbouring part, where this is allowed."""


Constraint = Forbidding | Admitting | Completing
"""A constraint has one or more of these methods, or ``for_mesh(mesh)``, which returns a constraint and may
use faces.
"""
