"""What each kind of component must offer. Nobody inherits anything: having the method is enough.

Which kinds there are, and what is checked when they are built: :mod:`agglo_core.registry.kinds`.

A *part* is a (block, label) pair: labels are local to their block. A *level* is a block-diagonal
:class:`~agglo_core.graph.Graph` whose blocks are the pieces of one recursion depth. The law every
component obeys: **a level is its blocks** — what happens to one block never depends on the others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, Mask, UInt64

if TYPE_CHECKING:
    from agglo_core.graph import Graph
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.mesh import Mesh
    from agglo_core.problems import MultigridLevel, Problem, Solution

__all__ = [
    "Admitting",
    "Aiming",
    "Bisector",
    "Completing",
    "ConnectivityFixer",
    "Constraint",
    "Forbidding",
    "Format",
    "HierarchyFormat",
    "IncrementalMetric",
    "LevelBisector",
    "Partitioner",
    "ProblemKind",
    "QualityMetric",
    "Refiner",
    "Section",
    "Sides",
    "Smoother",
    "Solver",
    "Target",
    "TargetAware",
    "WritableFormat",
]

Sides = NDArray[Any]
"""``(n,)`` integers or booleans in {0, 1}, or floats in [0, 1]: the probability of side 1."""


@dataclass(frozen=True)
class Target:
    """What the parts must satisfy: a count, or a mesh size.

    Attributes
    ----------
    parts : int, optional
        Number of parts wanted of the whole graph.
    h_star : float, optional
        Largest diameter allowed for a part, in the units of the graph.
    """

    parts: int | None = None
    h_star: float | None = None


@runtime_checkable
class Bisector(Protocol):
    """The simple form: split one connected graph in two."""

    def bisect(self, graph: Graph, rng: np.random.Generator) -> Sides:
        """Return the side of each node, shape ``(n,)``; both sides non-empty for n >= 2."""


@runtime_checkable
class LevelBisector(Protocol):
    """The fast form: split every block of a level in one call."""

    def bisect_level(self, level: Graph, seeds: UInt64) -> Sides:
        """Return the side of each node, shape ``(n,)``; ``seeds`` is ``(B,)``."""


@runtime_checkable
class TargetAware(Protocol):
    """Optional: a bisector that wants to know what the pieces are to become."""

    def for_target(self, target: Target) -> LevelBisector | Bisector:
        """Return the bisector for pieces that are to meet ``target``: ``self`` if nothing depends on it.

        Called before pieces are split. Nested sizes are then met one after the other, the coarsest first.
        """


@runtime_checkable
class Aiming(Protocol):
    """The form of :class:`TargetAware` in version 0.1, which is deprecated and still works."""

    def aim(self, target: Target) -> LevelBisector | Bisector:
        """Do what ``for_target`` does."""


@runtime_checkable
class Partitioner(Protocol):
    """Optional: direct k-way partition of a connected graph; refined unless ``final_parts = True``."""

    def partition(self, graph: Graph, target: Target, seed: int) -> Int:
        """Return labels ``(n,)`` in ``0..target.parts-1``, for a size ``0..n-1``; faults are mended."""


@runtime_checkable
class Refiner(Protocol):
    """Improves labels without emptying a part or raising any part's number of components.

    ``objective`` says what never gets worse: one of :data:`agglo_core.graph.objectives.OBJECTIVES`, such
    as ``"interface"`` (total length) or ``"compactness"`` (moment of inertia), or the name of a metric,
    whose values are then summed over the parts.
    """

    objective: str

    def refine(self, graph: Graph, labels: Int, seeds: UInt64, target: Target) -> Int:
        """Return new labels ``(n,)`` whose declared objective is no worse."""


@runtime_checkable
class ConnectivityFixer(Protocol):
    """Makes every part connected, keeping the label set of each block."""

    def fix(self, graph: Graph, labels: Int) -> Int:
        """Return new labels ``(n,)``; the identity on labels whose parts are all connected."""


@runtime_checkable
class QualityMetric(Protocol):
    """One number per agglomerate.

    ``homogeneity`` is the power p of a length that values scale with in 2-D: 0 for ratios, 1 for lengths. In
    3-D ratios are ratios too; where p is not 0, lengths may become areas: a whole power from p to 2 p.

    Four attributes are optional, false where they are missing. ``undefined``: some agglomerates have no
    value, which is NaN; reports count them, and means are over the others. ``directional``: values depend on
    the directions of the axes. ``relative``: values depend on far agglomerates too, as diam(P) / h does.
    ``shape_only``: the cells of an agglomerate change nothing, nor do the edges that they cut its outline in.
    """

    better: Literal["high", "low"]
    bounds: tuple[float, float]
    homogeneity: int

    def measure(self, mesh: Mesh, labels: Int) -> Float:
        """Return the value of each agglomerate, shape ``(k,)`` for labels ``0..k-1``."""


@runtime_checkable
class IncrementalMetric(Protocol):
    """Optional: a metric that can tell what a move would change, so that refiners can optimise it.

    Its objective is the sum of the values over all parts, in the direction of ``better``.
    """

    def changes(self, graph: Graph, labels: Int, cells: Int, parts: Int) -> Float:
        """Return by how much the sum of values changes ``(q,)`` if cell i alone moves to part i.

        ``labels (n,)`` number the parts of all blocks, 0..k-1; ``cells`` and ``parts`` are ``(q,)``.
        """


@runtime_checkable
class Format(Protocol):
    """Reads meshes from files of one format.

    ``suffixes`` are lower case, with their dot; ``lossless`` says whether what is written is read
    back to the last bit, hierarchy included. It refuses a file by an AggloError, and the next format of its
    suffix is tried; OSErrors are reported as they are; anything else is a bug of the format.

    Four attributes are optional, false where they are missing. ``last_resort``: it is tried after all others.
    ``reads_empty``: files of no bytes mean something to it. ``atomic``: its own ``write`` makes files appear
    whole or not at all. ``keeps_level_values``: its ``write`` takes a fourth argument, for each level numbers
    ``(k,)`` by name. ``recognises(head)`` may know a file of another suffix by its first 512 bytes.
    Options ``merge_points`` and ``allow_gaps`` (bool) of the constructor are what ``agglo.read`` sets.
    """

    suffixes: tuple[str, ...]
    lossless: bool

    def read(self, path: Path) -> Mesh:
        """Return the mesh of an existing file; an AggloError says why it is refused."""


@runtime_checkable
class WritableFormat(Protocol):
    """Optional: a format that is also written.

    Whatever files ``write`` leaves beside ``path`` move with it to where the user wants them. One that says
    ``tells_progress = True`` takes the keyword ``tell``, and calls ``tell(fraction, text)`` as it goes.
    """

    def write(self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        """Write the mesh, and the hierarchy if given; an AggloError says what the format cannot hold."""


@runtime_checkable
class HierarchyFormat(Protocol):
    """Optional: a format that keeps hierarchies as they are, targets and statistics included."""

    def read_hierarchy(self, path: Path) -> tuple[Mesh, Hierarchy | None]:
        """Return the mesh of an existing file and the hierarchy stored with it, if any."""


@runtime_checkable
class ProblemKind(Protocol):
    """A record of what is to be solved: a frozen class whose ``kind`` is the name it is declared by."""

    kind: ClassVar[str]

    @classmethod
    def from_table(cls, table: Mapping[str, Any], mesh: Mesh, folder: Path) -> Self:
        """Return the problem a TOML table describes; relative file names start from ``folder``.

        An AggloError names the key that is wrong.
        """

    @classmethod
    def example(cls, mesh: Mesh) -> Self:
        """Return a small problem with exactly one solution on any mesh: for laws and tests of solvers."""


@runtime_checkable
class Smoother(Protocol):
    """Smooths the error on one level of a multigrid method.

    One that works without the correction of the next level says ``uses_coarse = False``: none is factorised.
    """

    def setup(self, level: MultigridLevel) -> Callable[[Float, Float], Float]:
        """Return ``smooth(b, x)``: a better x ``(n,)``; it may be a ``multigrid.LevelSmoother`` as well."""


@runtime_checkable
class Forbidding(Protocol):
    """A constraint on pairs of neighbours."""

    def forbidden(self, graph: Graph) -> Mask:
        """Return ``(m,)``, for each CSR entry whether nothing may be joined across it; both directions agree.

        A part is connected without such edges; it may reach around the end of a barrier.
        """


@runtime_checkable
class Admitting(Protocol):
    """A constraint on what a part may hold; each piece of an admissible part must be admissible, too."""

    def admissible(self, graph: Graph, labels: Int) -> Mask:
        """Return ``(k,)``, for each part of ``labels (n,)`` whether it is allowed; others are split."""


@runtime_checkable
class Completing(Protocol):
    """A constraint on what a part should hold at least."""

    def incomplete(self, graph: Graph, labels: Int) -> Mask:
        """Return ``(k,)``, for each part whether it should join a neighbour, where nothing forbids it."""


Constraint = Forbidding | Admitting | Completing
"""A constraint has any of the three, or ``for_mesh(mesh)``, which returns such a one, if it needs faces."""


@runtime_checkable
class Section(Protocol):
    """A section of the report; where its fragment is empty it is left out."""

    title: str

    def html(self, mesh: Mesh, runs: Sequence[Any]) -> str:
        """Return a fragment of HTML about the runs (:class:`agglo_core.measure.RunResult`) on a mesh."""


@runtime_checkable
class Solver(Protocol):
    """Solves a problem with the help of a hierarchy of coarse meshes.

    ``accepts``, if present, lists the kinds of problem it takes; ``discretisation``, if present, says what
    its unknowns mean (:class:`~agglo_core.problems.Discretisation`). One that promises ``symmetric`` also
    has ``aspreconditioner(problem, hierarchy)``, which returns a ``scipy.sparse.linalg.LinearOperator``.
    One that needs no levels says ``needs_levels = False``, or if it is plain conjugate gradients ``plain_cg =
    True``; one whose coarse operators are not Pᵀ A P, but discretised anew or rounded, ``galerkin = False``.
    With ``tells_progress = True`` it takes ``progress``, None or for :func:`agglo_core.progress.phase`.
    """

    def solve(self, problem: Problem, hierarchy: Hierarchy) -> Solution:
        """Return the solution with its convergence history."""
