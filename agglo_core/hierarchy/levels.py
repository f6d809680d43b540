"""Hierarchy of coarse levels: labels, coarse meshes, and maps between levels."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from operator import index
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from agglo_core.arrays import FieldState, Int, first_of_each, frozen_int, index_cast, owned, trusted
from agglo_core.errors import MeshError, OptionError
from agglo_core.graph import Graph
from agglo_core.hierarchy.cut_search import best_nodes, check_grade
from agglo_core.hierarchy.cuts import Cut, ones_by_row
from agglo_core.hierarchy.forest import Forest, check_nested
from agglo_core.hierarchy.tree import by_first_cell
from agglo_core.mesh import Mesh, check_labels
from agglo_core.mesh.elsewhere import import_function

if TYPE_CHECKING:
    from agglo_core.measure import Quality


def _whole(level: Any) -> int:
    try:
        return index(level)
    except TypeError:
        raise TypeError(f"a level must be a whole number, given {level!r:.60}") from None


@dataclass(frozen=True, eq=False)
class Hierarchy(FieldState):
    """Hierarchy of coarse levels of a mesh or graph, with a labelling of the cells for each level.

    ``h[i]`` are the labels of level i, ``h[-1]`` those of the coarsest; ``len(h)`` is the number of levels. A
    hierarchy without levels is false, like an empty list: compare with None to detect an absent hierarchy.

    Attributes
    ----------
    fine : Mesh or None
        The fine mesh; None if a Graph was agglomerated.
    graph : Graph
        Its dual graph.
    levels : list of (n_cells,) int
        ``levels[0]`` is the finest coarse level; labels 0..k−1 numbered by smallest cell id. One level per
        target; equal levels are kept.
    targets : list of mapping
        Target per level, e.g. ``{"h_star": 0.3}``.
    nested : bool
        True if each level is a coarsening of the previous level.
    statistics : mapping
        Run statistics as plain data.

    Raises
    ------
    MeshError
        For labels that are masked, not integers, of another shape, or that leave gaps.
    OptionError
        If the target and level counts differ, or levels declared as nested are not.

    Examples
    --------
    >>> hierarchy = agglo.agglomerate(agglo.samples.squares(8), n_parts=(16, 4))
    >>> hierarchy
    Hierarchy(64 cells -> 16, 4 parts)
    >>> hierarchy.parents(0).tolist()
    [0, 0, 1, 1, 0, 0, 1, 1, 2, 2, 3, 3, 2, 2, 3, 3]
    >>> hierarchy.prolongation(0).shape
    (64, 16)
    """

    fine: Mesh | None
    graph: Graph
    levels: Sequence[Int]
    targets: Sequence[Mapping[str, Any]]
    nested: bool
    statistics: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if len(self.levels) != len(self.targets):
            raise OptionError(f"{len(self.levels)} levels but {len(self.targets)} targets")
        n = self.graph.n
        if self.fine is not None and self.fine.n_cells != n:
            raise MeshError(f"the mesh has {self.fine.n_cells} cells, its graph {n} nodes")
        object.__setattr__(self, "levels", tuple(owned(check_labels(labels, n)) for labels in self.levels))
        if self.nested:
            check_nested(self.levels)

    def __repr__(self) -> str:
        return f"Hierarchy({self.graph.n} cells -> {', '.join(str(k) for k in self.parts)} parts)"

    def __len__(self) -> int:
        return len(self.levels)

    def __getitem__(self, level: int) -> Int:
        place = _whole(level)
        return self._level(place + len(self) if -len(self) <= place < 0 else place)

    def __iter__(self) -> Iterator[Int]:
        return iter(self.levels)

    @property
    def labels(self) -> Int:
        """Labels of the finest coarse level ``(n_cells,)``, read-only, the array ``levels[0]``.

        Raises
        ------
        IndexError
            If the hierarchy has no levels.

        Examples
        --------
        >>> hierarchy = agglo.agglomerate(agglo.samples.squares(2), n_parts=(2, 1))
        >>> len(hierarchy), hierarchy.labels, hierarchy[-1]
        (2, array([0, 0, 1, 1]), array([0, 0, 0, 0]))
        """
        return self[0]

    @cached_property
    def parts(self) -> list[int]:
        """Agglomerate count per level."""
        return [int(labels.max()) + 1 for labels in self.levels]

    @property
    def fingerprint(self) -> str:
        """Hash that identifies the fine mesh.

        The value is empty for a graph.
        """
        return self.fine.fingerprint if self.fine is not None else ""

    def _level(self, level: int) -> Int:
        if not 0 <= _whole(level) < len(self):
            known = f"levels 0..{len(self) - 1}" if len(self) else "no levels"
            raise IndexError(f"level {level} is out of range: the hierarchy has {known}")
        return self.levels[level]

    def _coarser(self, level: int) -> Int:
        if level + 1 == len(self):
            raise IndexError(f"level {level} is the coarsest: no level contains its agglomerates")
        return self._level(level + 1)

    def _fine_mesh(self) -> Mesh:
        if self.fine is None:
            raise MeshError(
                "this hierarchy belongs to a graph without a mesh: agglomerate the Mesh instead of its graph"
            )
        return self.fine

    def parents(self, level: int) -> Int:
        """Return the parent on level + 1 of each agglomerate on ``level``, shape ``(n_level,)``.

        Raises
        ------
        ValueError
            If the hierarchy is not nested.
        IndexError
            For the coarsest level, or a level that does not exist.
        """
        if not self.nested:
            raise OptionError(
                f"the hierarchy is not nested: use overlap({level}), or agglomerate with nested=True"
            )
        fine, coarse = self._level(level), self._coarser(level)
        parents = np.empty(self.parts[level], np.int64)
        parents[fine] = coarse
        return frozen_int(parents)

    def overlap(self, level: int) -> sparse.csr_array[Any, Any]:
        """Return the measures of the intersections of agglomerates, ``(n_{level+1}, n_level)``.

        The hierarchy need not be nested.
        """
        fine, coarse = self._level(level), self._coarser(level)
        places = tuple(index_cast(labels, self.graph.n) for labels in (coarse, fine))
        shape = (self.parts[level + 1], self.parts[level])
        return sparse.csr_array(sparse.coo_array((self.graph.measures, places), shape=shape))

    def prolongation(self, level: int) -> sparse.csr_array[Any, Any]:
        """Return the 0-1 prolongation from ``level`` to the next finer level, ``(n_{level−1}, n_level)``.

        The next finer level of level 0 is the mesh itself.

        Raises
        ------
        ValueError
            If the hierarchy is not nested and ``level > 0``.
        """
        labels = self._level(level)
        columns = labels if level == 0 else self.parents(level - 1)
        return ones_by_row(columns, self.parts[level])

    def mesh(self, level: int) -> Mesh:
        """Return the coarse mesh on ``level``: 0 is the finest, −1 the coarsest.

        Raises
        ------
        IndexError
            If there is no such level.
        MeshError
            If a Graph without mesh was agglomerated.
        """
        return self._fine_mesh().coarsen(self[level])

    def quality(self, level: int = 0, metrics: Iterable[Any] | None = None, **options: Any) -> Quality:
        """Compute quality metrics of every agglomerate of a level, by :func:`agglo_core.quality`.

        Parameters
        ----------
        level : int
            0 is the finest, −1 the coarsest.
        metrics, **options : optional
            As for :func:`agglo_core.quality`, with its defaults.

        Returns
        -------
        Quality
            A dict from name to (n_level,) float, displayed as a table.

        Raises
        ------
        IndexError
            If there is no such level.
        MeshError
            If a Graph without mesh was agglomerated, or a metric exists only in 2-D.
        OptionError, PluginError
            As for :func:`agglo_core.quality`.

        Examples
        --------
        >>> hierarchy = agglo.agglomerate(agglo.samples.squares(8), n_parts=(16, 4))
        >>> hierarchy.quality(metrics=("CR", "cells"))
        Quality of 16 agglomerates
                 mean   least  largest
        CR     0.7071  0.7071   0.7071
        cells       4       4        4
        """
        from agglo_core.measure import quality

        chosen = options if metrics is None else {"metrics": metrics, **options}
        return quality(self._fine_mesh(), self[level], **chosen)

    def write(self, path: str | PathLike[str], **options: Any) -> None:
        """Write the fine mesh and the hierarchy to a file, by :func:`agglo_core.write`.

        Parameters
        ----------
        path : path
            The suffix selects the format.
        **options : optional
            Keyword arguments of :func:`agglo_core.write`, such as ``compress``.

        Raises
        ------
        MeshError
            If a Graph without mesh was agglomerated, or the file cannot hold a tag name.
        FileError, OptionError, PluginError
            As for :func:`agglo_core.write`.

        Examples
        --------
        >>> agglo.agglomerate(agglo.samples.squares(8), n_parts=(16, 4)).write("levels.npz")
        >>> agglo.read_hierarchy("levels.npz")[1]
        Hierarchy(64 cells -> 16, 4 parts)
        """
        from agglo_core.io import write

        write(path, self._fine_mesh(), self, **options)

    def view(
        self,
        level: int = 0,
        *,
        explode: float = 0.0,
        section: Sequence[float] | None = None,
        path: str | PathLike[str] | None = None,
    ) -> None:
        """Show a level in 3-D, in a window or as a picture, see :func:`agglo_core.draw.solids.scene.view`."""
        import_function("agglo_core.draw.solids.scene:view")(
            self, level, explode=explode, section=section, path=path
        )

    def plot(
        self,
        level: int = 0,
        ax: Any = None,
        *,
        values: str | ArrayLike | None = None,
        cmap: str = "viridis",
        explode: float | None = None,
        section: Sequence[float] | None = None,
        registry: Any = None,
    ) -> Any:
        """Draw the agglomerates of a level on matplotlib axes, with different colours for neighbours.

        Parameters
        ----------
        level : int
            0 is the finest, −1 the coarsest.
        ax, cmap, section : optional
            As for :meth:`agglo_core.Mesh.plot`.
        values : str or (n_level,) float, optional
            Colours: a metric name, or numbers, with a colour bar; grey for non-finite values.
        explode : float, optional
            In 3-D: shift of each agglomerate away from the middle of the mesh, relative to their distance,
            from 0 to 10; by default 0.35.
        registry : Registry, optional
            Registry with the metrics; by default the installed plugins.

        Returns
        -------
        matplotlib.axes.Axes

        Raises
        ------
        OptionError, PluginError
            Without matplotlib, or for invalid arguments.
        MeshError
            If the hierarchy has no mesh.
        IndexError
            If there is no such level.

        Examples
        --------
        >>> from agglo_core import agglomerate, samples
        >>> ax = agglomerate(samples.squares(8), n_parts=4).plot(values="CR")
        >>> ax.figure.axes[-1].get_ylabel()  # of the colour bar
        'CR'
        """
        return import_function("agglo_core.draw.on_axes:plot_level")(
            self, level, ax, values=values, cmap=cmap, explode=explode, section=section, registry=registry
        )

    def _repr_html_(self) -> str:
        html: str = import_function("agglo_core.draw.notebook:hierarchy_html")(self)
        return html

    # -- cuts ----------------------------------------------------------------------------------
    @cached_property
    def forest(self) -> Forest:
        """Parts of all levels as trees, whose cuts are coarse meshes.

        Raises
        ------
        OptionError
            If the hierarchy is not nested.
        """
        if not self.nested:
            raise OptionError(
                "the hierarchy is not nested: only nested levels have cuts; agglomerate with nested=True"
            )
        return Forest.of(self.levels, self.graph.n)

    def cut(
        self,
        n_parts: int,
        indicator: ArrayLike | None = None,
        *,
        objective: str = "largest",
        grade: int | None = None,
    ) -> Cut:
        """Return the best coarse mesh with at most ``n_parts`` parts, each from any level or a single cell.

        A part's indicator is the sum over its cells. Objective ``largest`` minimises the largest part
        indicator over all cuts of this size (with the same grade, if any). The parts with the next largest
        indicators are then split while they fit, until no part can be split or the rest have indicator 0.
        Objective ``squares`` minimises the sum of squared indicators (for a given part count, equal
        indicators are optimal), in time proportional to cells times parts. The part count may stay below
        ``n_parts``, because a part is always split into all of its children.

        Parameters
        ----------
        n_parts : int
            Maximum part count; the coarsest level has the fewest.
        indicator : (n,) float, optional
            Non-negative value per fine cell: an estimated error, a speed, the vicinity of a well. By default
            the measure, so that parts are as equal as the levels allow.
        objective : {"largest", "squares"}
        grade : int, optional
            Maximum level difference between parts that share a face (1 is usual); by default unlimited. For a
            part of several levels the smallest difference counts. Not available with ``squares``.

        Raises
        ------
        OptionError
            If the hierarchy is not nested, an argument is invalid, or the coarsest level has more parts.
        """
        nodes = best_nodes(self.forest, self.graph, indicator, n_parts, objective, grade)
        return Cut(self.fine, self.graph, self.forest, nodes, grade)

    def cut_at(self, level: int, *, grade: int | None = None) -> Cut:
        """Return one level (−1: the cells) as a cut, to be changed locally by ``refine`` and ``coarsen``."""
        if not -1 <= level < len(self.levels):
            raise IndexError(
                f"level {level} is out of range: the hierarchy has levels 0..{len(self.levels) - 1}, and "
                "-1 for the cells"
            )
        check_grade(grade)
        return Cut(self.fine, self.graph, self.forest, self.forest.level(level), grade)

    def above(self, cut: Cut) -> Hierarchy:
        """Return the hierarchy for multigrid on a cut: its mesh, and the levels that coarsen it somewhere.

        Raises
        ------
        OptionError
            If the cut belongs to another hierarchy.
        """
        if not cut.forest.matches(self.forest):
            raise OptionError("the cut belongs to another hierarchy")
        cells, levels, targets = first_of_each(cut.labels), [], []
        for level, (labels, target) in enumerate(zip(self.levels, self.targets, strict=True)):
            stays = cut.levels >= level
            if not stays.all():
                levels.append(
                    by_first_cell(np.where(stays, self.graph.n + np.arange(cut.n_parts), labels[cells]))
                )
                targets.append(target)
        mesh = cut.mesh if self.fine is not None else None
        graph = mesh.graph if mesh is not None else self.graph.coarsen(cut.labels)
        return trusted(Hierarchy, mesh, graph, tuple(levels), targets, True)
