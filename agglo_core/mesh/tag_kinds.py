"""Which tags occur together: what tables by tag are checked against, also in a part of a larger mesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from agglo_core.arrays import Int, frozen_int


class BoundaryKinds(NamedTuple):
    """Combinations of face tags on the boundary.

    Attributes
    ----------
    component : (k,) int
        The component of the domain, by its first cell.
    tags : mapping of name to (k,) int
        Values of the tags.
    """

    component: Int
    tags: Mapping[str, Int]


def distinct(columns: Sequence[Int]) -> list[Int]:
    """The rows of a table, each once, in any order.

    Examples
    --------
    >>> from agglo_core.mesh.tag_kinds import distinct
    >>> distinct([np.array([1, 2, 1]), np.array([5, 5, 5])])
    [array([1, 2]), array([5, 5])]
    """
    if not columns:
        return []
    row = np.zeros(len(columns[0]), np.int64)
    for values in columns:
        own, place = np.unique(values, return_inverse=True)
        row = np.unique(row * len(own) + place, return_inverse=True)[1]
    first = np.unique(row, return_index=True)[1]
    return [frozen_int(np.asarray(values)[first]) for values in columns]
