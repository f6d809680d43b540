"""Find the best coarse mesh of a given size with parts of several levels (a cut), optionally graded."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float, Int, exact_cast, frozen_float, frozen_int, plain_array
from agglo_core.errors import OptionError
from agglo_core.graph import Graph
from agglo_core.hierarchy.forest import Forest

OBJECTIVES = ("largest", "squares")


def best_nodes(
    forest: Forest, graph: Graph, indicator: ArrayLike | None, n_parts: int, objective: str, grade: int | None
) -> Int:
    """Return the tree nodes of the best cut with at most ``n_parts`` parts.

    Arguments are as in ``Hierarchy.cut``.
    """
    from agglo_core.hierarchy.tree_cuts import refine_largest

    if objective not in OBJECTIVES:
        raise OptionError(f"objective must be one of {', '.join(OBJECTIVES)}; given {objective!r}")
    if isinstance(n_parts, bool) or not isinstance(n_parts, int | np.integer):
        raise OptionError(f"n_parts must be a whole number; given {n_parts!r}")
    if n_parts < forest.n_roots:
        raise OptionError(
            f"no cut has {n_parts} parts: the coarsest level, the smallest cut, has {forest.n_roots}"
        )
    check_grade(grade)
    value = forest.sums(_check_indicator(indicator, graph))
    if objective == "squares":
        return _least_squares(forest, value, n_parts, grade)
    node_of = refine_largest(*_shape(forest, graph, grade), value, forest.n_roots, n_parts)
    return frozen_int(np.unique(node_of))


def grade_cut(forest: Forest, graph: Graph, nodes: Int, grade: int) -> Int:
    """Return the coarsest refinement of a cut whose adjacent levels differ by at most ``grade``."""
    from agglo_core.hierarchy.tree_cuts import make_graded

    node_of = np.empty(graph.n, np.int64)
    ordered_nodes = nodes[np.argsort(forest.start[nodes])]
    node_of[forest.cells] = np.repeat(ordered_nodes, forest.stop[ordered_nodes] - forest.start[ordered_nodes])
    make_graded(*_shape(forest, graph, grade), node_of)
    return frozen_int(np.unique(node_of))


def check_grade(grade: int | None) -> None:
    """Raise OptionError unless the grade (largest level difference) is None or a positive integer."""
    if grade is not None and (
        isinstance(grade, bool) or not isinstance(grade, int | np.integer) or grade < 1
    ):
        raise OptionError(f"grade must be None or a whole number, 1 or more; given {grade!r}")


def _least_squares(forest: Forest, value: Float, n_parts: int, grade: int | None) -> Int:
    from agglo_core.hierarchy.tree_sums import least_cut

    if grade is not None:
        raise OptionError(
            "grade requires objective='largest': the smallest sum with a grade cannot be computed"
        )
    most = min(n_parts, len(forest.cells))
    largest = value[: forest.n_roots].max()
    cost = frozen_float((value / largest if largest > 0 else value) ** 2)
    return frozen_int(
        np.flatnonzero(least_cut(forest.first_child, forest.n_children, cost, forest.n_roots, most))
    )


def _shape(forest: Forest, graph: Graph, grade: int | None) -> tuple[Any, Any, int]:
    """Return forest and graph as arrays for compiled loops, and the grade (−1 for none)."""
    trees = (
        forest.cells,
        forest.start,
        forest.stop,
        forest.first_child,
        forest.n_children,
        forest.finest,
        forest.coarsest,
    )
    return trees, (graph.indptr, graph.indices), -1 if grade is None else int(grade)


def _check_indicator(indicator: ArrayLike | None, graph: Graph) -> Float:
    """Return the checked refinement indicator ``(n,)`` of the cells, by default their measures.

    It must be finite and non-negative.
    """
    if indicator is None:
        return graph.measures
    array = plain_array(indicator, "the indicator", OptionError)
    values = frozen_float(exact_cast(array, np.float64, "the indicator", OptionError))
    if values.shape != (graph.n,):
        raise OptionError(
            f"the indicator has shape {values.shape}, expected ({graph.n},), one value for each cell"
        )
    wrong = np.flatnonzero(~((values >= 0) & (values < np.inf)))
    if len(wrong):
        raise OptionError(
            f"the indicator must be finite and not negative; cell {wrong[0]} has {values[wrong[0]]:g} "
            f"({len(wrong)} such cells)"
        )
    return values
