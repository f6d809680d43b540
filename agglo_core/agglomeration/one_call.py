"""The function :func:`agglomerate`: a complete agglomeration run in one call."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from numbers import Integral, Real
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from agglo_core.agglomeration.keywords import (
    COUNTS,
    NAMES,
    SIZES,
    TARGETS,
    Balance,
    Choice,
    Marks,
    Method,
    Names,
    Numbers,
)
from agglo_core.agglomeration.pipeline import Pipeline
from agglo_core.errors import OptionError
from agglo_core.graph import Graph
from agglo_core.hierarchy import Hierarchy
from agglo_core.mesh import Mesh
from agglo_core.progress import Listener
from agglo_core.registry import Registry
from agglo_core.suggestions import suggest_keywords

_DEFAULT = Pipeline()


def _keyword_for(value: object) -> str:
    """Return the probable keyword for a value that was given without a name."""
    first = value[0] if isinstance(value, list | tuple) and value else value
    if isinstance(first, str):
        return "bisector"
    return "h_star" if isinstance(first, Real) and not isinstance(first, Integral) else "n_parts"


@suggest_keywords(_keyword_for)
def agglomerate(
    mesh: Mesh | Graph,
    *,
    h_star: Numbers | None = None,
    h_factor: Numbers | None = None,
    n_parts: Numbers | None = None,
    cells_per_part: Numbers | None = None,
    bisector: Choice | None = None,
    refiners: Sequence[Choice] | None = None,
    fixer: Choice | None = None,
    method: Method | None = None,
    nested: bool | None = None,
    merge: bool | None = None,
    polish: bool | None = None,
    post_refiners: Sequence[Choice] | None = None,
    seed: int | None = None,
    constraints: Sequence[Choice] | None = None,
    regions: Names | ArrayLike | None = None,
    barriers: Marks | None = None,
    where: Marks | None = None,
    boundary_rules: Literal["ridges"] | None = None,
    weights: str | ArrayLike | None = None,
    balance: Balance | None = None,
    max_cells: int | None = None,
    min_cells: int | None = None,
    max_measure: float | None = None,
    max_weight: float | None = None,
    min_measure: float | None = None,
    min_weight: float | None = None,
    metric: ArrayLike | None = None,
    lines: bool | None = None,
    config: str | os.PathLike[str] | None = None,
    allow_code: bool = False,
    registry: Registry | None = None,
    progress: Listener | None = None,
    verbose: bool = False,
    threads: int | None = None,
) -> Hierarchy:
    """Agglomerate a mesh or graph into a hierarchy of coarse levels (paper, Algorithm 1).

    All parameters except the mesh are given by name. There are four groups:

    Targets
        h_star, h_factor, n_parts, cells_per_part
    Method
        bisector, refiners, fixer, method, nested, merge, polish, post_refiners, seed
    Rules for parts
        constraints, regions, barriers, where, boundary_rules, weights, balance, max_cells, min_cells,
        max_measure, max_weight, min_measure, min_weight, metric, lines
    Running
        config, allow_code, registry, progress, verbose, threads

    Parameters
    ----------
    mesh : Mesh or Graph
    h_star : float or sequence, optional
        Target: largest diameter of a part, one level per value. Only one kind of target may be given.
    h_factor : float or sequence, optional
        Target: largest diameter of a part in units of the mesh size h0, the largest diameter of a cell.
    n_parts : int or sequence, optional
        Target: exact number of parts. An unreachable number raises an error.
    cells_per_part : float or sequence, optional
        Target: mean number of cells. Each connected component, also of a region, is at least one part.
        Without any target: 8, 64, 512, … down to about 12 parts, that is ``max(1, round(log8(n / 12)))``
        levels of a mesh with n cells.
    bisector : str, (str, options) or component object, optional
        Component that splits a piece in two. Default ``"kmeans"``.
    refiners : sequence of components, optional
        Components that shorten the interface of each split, in this order; ``()`` for none. Default
        ``("interface",)``.
    fixer : component, optional
        Component that connects both sides of each split. Default ``"connectivity"``.
    method : "recursive" or "kway", optional
        ``"kway"`` needs a bisector that implements ``partition``. Default ``"recursive"``.
    nested : bool, optional
        Whether each level coarsens the previous level. Default True.
    merge : bool, optional
        Only with ``h_star`` or ``h_factor``: merge adjacent parts while their union meets the target. Default
        False.
    polish : bool, optional
        Whether ``post_refiners`` run on each finished level. Default True.
    post_refiners : sequence of components, optional
        Components that move cells between finished parts. Moves that make a part miss its size are undone.
        Default ``("compactness",)``.
    seed : int, optional
        Root seed for all random numbers. Default 0.
    constraints : sequence of components, optional
        Custom rules, instead of or in addition to the following keywords. Default ``()``.
    regions : str, sequence of str or (n,) array, optional
        No part contains cells from two regions. Regions are the values in an array, or in the given cell
        tags.
    barriers : str, sequence of str, mapping of str to values, or (n_faces,) bool, optional
        Fractures, faults, walls: no part lies on both sides of such a face, not even around its end. A name
        selects the faces where this tag is neither 0 nor −1; ``"name=3"`` selects the value 3.
    where : str, sequence of str, mapping or (n,) bool, optional
        Agglomerate only these cells. All other cells stay single at every level.
    boundary_rules : "ridges", optional
        Join only cells that touch equal boundary patches. Cells at corners stay single.
    weights : str or (n,) array, optional
        Cell data name, or numbers. Counts are distributed by these weights, and bounds on weights refer to
        them.
    balance : "cells", "measure" or "weights", optional
        Quantity by which counts are distributed, also without a target. Default: weights if given, else
        cells.
    max_cells : int, optional
        Largest number of cells in a part.
    min_cells : int, optional
        Smaller parts join a neighbour unless a rule forbids the union. ``statistics`` counts the remaining
        small parts.
    max_measure, max_weight : float, optional
        Largest area or volume, or largest ``weights`` sum, in a part. Single cells may exceed it.
    min_measure, min_weight : float, optional
        Smaller or lighter parts join a neighbour, as with ``min_cells``.
    metric : (d, d) or (n, d, d) float, optional
        Symmetric positive definite tensor, constant or per cell, in which diameters, distances and interfaces
        are measured. Parts are long in directions where the metric makes lengths short. Size targets also use
        the metric.
    lines : bool, optional
        Keep lines of strongly coupled cells, as in boundary layers: a part consists of whole lines, or of
        cells in a single line. Default False.
    config : path, optional
        TOML file with these names as keys. Call arguments take precedence.
    allow_code : bool, optional
        Whether options in ``config`` may name code. Such code is imported and run. Default False.
    registry : Registry, optional
        Registry for name look-up. Its plugins follow the run. Default: the installed components.
    progress : callable, optional
        Called with an :class:`~agglo_core.progress.Progress` for each phase and its completed share, at most
        20 times a second. An exception from the callable ends the run and passes through unchanged.
    verbose : bool, optional
        Show the progress on stderr: a bar on a terminal, lines otherwise.
    threads : int, optional
        Maximum number of threads. The result does not depend on it. Default: the environment variable
        ``AGGLO_THREADS``, else 1.

    Returns
    -------
    Hierarchy
        Every part is connected. In size mode ``diam <= h_star``, except for larger single cells (counted in
        ``statistics``).

    Raises
    ------
    OptionError
        If targets or options are invalid, or contradict each other or the constraints.
    PluginError
        If a component is missing, unusable, or misbehaves.

    Examples
    --------
    >>> mesh = agglo.samples.squares(8)
    >>> agglo.agglomerate(mesh, n_parts=(16, 4))
    Hierarchy(64 cells -> 16, 4 parts)
    >>> agglo.agglomerate(mesh, bisector="coordinate", h_factor=4, polish=False).parts
    [4]
    >>> agglo.agglomerate(agglo.samples.squares(40))
    Hierarchy(1600 cells -> 200, 25 parts)
    """
    keywords = {name: value for name, value in locals().items() if name in NAMES}
    if not isinstance(mesh, Mesh | Graph):
        remedy = ""
        if sparse.issparse(mesh):
            remedy = ": pass a matrix as agglomerate(Graph.from_scipy(A), …)"
        elif isinstance(mesh, str | os.PathLike):
            remedy = ": pass a file as agglomerate(read(path), …)"
        elif isinstance(mesh, np.ndarray | tuple):
            remedy = ": pass points and cells as agglomerate(Mesh.from_polygons(points, cells), …)"
        raise OptionError(f"agglomerate needs a Mesh or a Graph, given {type(mesh).__name__}{remedy}")
    base = _DEFAULT if config is None else Pipeline.from_toml(config, allow_code=allow_code)
    return replace_keywords(base, keywords).run(mesh, registry, progress, verbose, threads)


def replace_keywords(base: Pipeline, given: Mapping[str, Any]) -> Pipeline:
    """Return a copy of the pipeline ``base`` with the given keywords, where None keeps its value.

    A target replaces any other target, and resets the keywords that it excludes. Counts reset ``merge``.
    Sizes reset ``balance``, and ``weights`` unless there are bounds on weights.
    """
    explicit = {name: value for name, value in given.items() if value is not None}
    counts, sizes = (any(name in explicit for name in names) for names in (COUNTS, SIZES))
    reset: dict[str, Any] = dict.fromkeys(TARGETS if counts or sizes else ())
    reset |= {"merge": False} if counts else {}
    reset |= {"balance": None} if sizes else {}
    bounds = (explicit.get(name, getattr(base, name)) for name in ("max_weight", "min_weight"))
    bounded = any(bound is not None for bound in bounds)
    reset |= {"weights": None} if sizes and not bounded else {}
    return replace(base, **{**reset, **explicit})
