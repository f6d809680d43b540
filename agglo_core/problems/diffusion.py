"""Diffusion, convection and reaction: −∇·(κ∇u) + b·∇u + c u = f.

As a TOML table, with numbers by cell tag and boundary tag (no expressions):

.. code-block:: toml

    source = 1.0                              # a number for all cells,
    convection = [1.0, 0.5]                   # the vector b
    [kappa.material]                          # or one for each value of a cell tag
    1 = 1.0
    2 = [[2.0, 0.5], [0.5, 1.0]]              # or a symmetric positive definite matrix
    [reaction.material]                       # c >= 0
    1 = 0.0
    2 = 5.0
    [dirichlet]                               # by value of the face tag "boundary"
    1 = 0.0
    [neumann]                                 # outward flux κ ∂u/∂n; faces without entry are insulated
    2 = 1.0
    [robin.3]                                 # alpha u + κ ∂u/∂n = value, alpha >= 0
    alpha = 10.0
    value = 2.0

Default κ and source are 1; default reaction and convection are 0. Without [dirichlet], [neumann] and
[robin], u = 0 on the whole boundary. With [neumann] alone and no reaction, source and fluxes must balance,
and u has mean 0. A first line ``boundary = "gmsh:physical"`` selects another face tag instead of
"boundary".
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from agglo_core.arrays import Float, exact_cast, plain_array
from agglo_core.errors import OptionError
from agglo_core.mesh import Mesh
from agglo_core.problems.discretisation import Field
from agglo_core.problems.table import (
    boundary_values,
    cell_values,
    face_tag,
    require_by_tag,
    require_keys,
    robin_values,
    tensor_values,
    vector,
)
from agglo_core.suggestions import suggest_keywords

_KEYS = ("boundary", "kappa", "convection", "reaction", "source", "dirichlet", "neumann", "robin")
_BOUNDARY = "boundary"
_ZERO = 1e-9  # maximum |u| that counts as 0 on the boundary, in the unit of u
_log = logging.getLogger("agglo")


@suggest_keywords()
@dataclass(frozen=True, eq=False)
class Diffusion:
    """Find u with −∇·(κ∇u) + b·∇u + c u = f, given boundary data by tag.

    Attributes
    ----------
    kappa : Field, (d, d) or (n_cells, d, d) float, or callable
        Diffusion coefficient: positive, or a symmetric positive definite tensor. A callable returns values
        ``(q,)``, or ``(q, d, d)`` for a tensor.
    source : Field
        Right-hand side f.
    dirichlet : mapping of boundary tag value to Field
        Boundary values u. Without boundary data of any kind, u = 0 on the whole boundary.
    neumann : mapping of boundary tag value to Field
        Outward fluxes κ ∂u/∂n. Faces with tags in no mapping are insulated. On a domain component with
        neither Dirichlet data, positive α nor positive reaction, u is determined only up to a constant:
        source and fluxes must then balance, and u has mean 0.
    exact : callable, optional
        Exact solution, if known, for error norms. A solver that discretises the problem refuses it if it
        differs from the Dirichlet data on the boundary. It must have mean 0 where u has.
    boundary : str
        Face tag with the boundary parts. On a mesh without the tag ``"boundary"``, all faces have
        the value 0.
    reaction : Field
        Coefficient c, not negative.
    convection : (d,) or (n_cells, d) float, or callable
        Velocity b, discretised upwind. A callable returns values ``(q, d)``. Its normal component should be
        continuous. The problem is well posed if c − ½ ∇·b ≥ 0, which is not checked. The matrix is not
        symmetric.
    robin : mapping of boundary tag value to (Field, Field)
        α and g of α u + κ ∂u/∂n = g, α not negative.

    Raises
    ------
    OptionError
        For data of any other form.

    Examples
    --------
    >>> problem = agglo.Diffusion(kappa=2.0, source=lambda x: x[:, 0])
    >>> problem.kappa, problem.dirichlet
    (2.0, {})

    Boundary values on a mesh without boundary tags, and the errors against the exact solution:

    >>> def u(x):
    ...     return x[:, 0] ** 2 - x[:, 1]
    >>> problem = agglo.Diffusion(source=-2.0, dirichlet={0: u}, exact=u)
    >>> solution = agglo.solve(agglo.samples.voronoi(50), problem, degree=2)
    >>> bool(solution.errors()["l2"] < 1e-6)
    True
    """

    kind: ClassVar[str] = "diffusion"

    kappa: Any = 1.0
    source: Field = 1.0
    dirichlet: Mapping[int, Field] = field(default_factory=dict)
    neumann: Mapping[int, Field] = field(default_factory=dict)
    exact: Callable[[Float], Float] | None = None
    boundary: str = _BOUNDARY
    reaction: Field = field(default=0.0, kw_only=True)
    convection: Any = field(default=0.0, kw_only=True)
    robin: Mapping[int, tuple[Field, Field]] = field(default_factory=dict, kw_only=True)

    def __post_init__(self) -> None:
        for name in ("kappa", "source", "reaction", "convection"):
            if isinstance(getattr(self, name), str):
                raise OptionError(
                    f"{name} must be a number, an array with one value per cell, or a callable; given "
                    f"{getattr(self, name)!r}"
                )
        for name in ("dirichlet", "neumann", "robin"):
            require_by_tag(name, getattr(self, name), self.boundary, "data")
        data = {f"dirichlet[{tag}]": value for tag, value in self.dirichlet.items()}
        data |= {f"neumann[{tag}]": value for tag, value in self.neumann.items()}
        for tag, pair in self.robin.items():
            if not isinstance(pair, tuple) or len(pair) != 2:
                raise OptionError(f"robin[{tag}] must be a pair (alpha, g), given {pair!r:.60}")
            data |= {f"alpha of robin[{tag}]": pair[0], f"g of robin[{tag}]": pair[1]}
        for name, value in (
            {name: getattr(self, name) for name in ("kappa", "source", "reaction", "convection")} | data
        ).items():
            if not callable(value):
                exact_cast(plain_array(value, name, OptionError), np.float64, name, OptionError)
        if self.exact is not None and not callable(self.exact):
            raise OptionError(f"exact must be a callable of points; given {self.exact!r:.60}")

    @classmethod
    def from_table(cls, table: Mapping[str, Any], mesh: Mesh, folder: Path) -> Self:
        """Build the problem from a table. The format is described in :mod:`agglo_core.problems.diffusion`.

        Raises
        ------
        OptionError
            For an unknown or missing key, tag or value, numbers that are not finite, κ ≤ 0, or c < 0.
        """
        require_keys(table, _KEYS)
        empty = [key for key in ("dirichlet", "neumann", "robin") if table.get(key) == {}]
        if empty:
            raise OptionError(
                f"[{empty[0]}] is empty: give a number for each boundary tag, or leave the table out"
            )
        boundary = face_tag("boundary", table.get("boundary", _BOUNDARY), mesh, always=_BOUNDARY)
        dirichlet = boundary_values("dirichlet", table.get("dirichlet", {}), mesh, boundary)
        neumann = boundary_values("neumann", table.get("neumann", {}), mesh, boundary)
        robin = robin_values("robin", table.get("robin", {}), mesh, boundary)
        kinds: dict[str, Mapping[int, Any]] = {"dirichlet": dirichlet, "neumann": neumann, "robin": robin}
        for one, other in combinations(kinds, 2):
            both = sorted(set(kinds[one]) & set(kinds[other]))
            if both:
                raise OptionError(f"boundary tag {both[0]} is in both {one} and {other}")
        kappa = tensor_values("kappa", table.get("kappa", 1.0), mesh)
        least = np.min(kappa if np.ndim(kappa) < 2 else np.linalg.eigvalsh(kappa))
        if least <= 0.0:
            tensors = "" if np.ndim(kappa) < 2 else " definite: its least eigenvalue is"
            raise OptionError(f"kappa must be positive{tensors or ', given'} {least:g}")
        reaction = cell_values("reaction", table.get("reaction", 0.0), mesh)
        if np.min(reaction) < 0.0:
            raise OptionError(f"reaction must not be negative, given {np.min(reaction):g}")
        convection = vector("convection", table.get("convection", [0.0] * mesh.dim), mesh.dim)
        source = cell_values("source", table.get("source", 1.0), mesh)
        return cls(
            kappa,
            source,
            dirichlet,
            neumann,
            boundary=boundary,
            reaction=reaction,
            convection=convection,
            robin=robin,
        )

    @classmethod
    def example(cls, mesh: Mesh) -> Self:
        """Return the example −Δu = 1 with u = 0 on the whole boundary."""
        return cls()

    def posed_on(self, mesh: Mesh) -> Self:
        """Return the problem, without the exact solution if that violates u = 0 on the mesh boundary."""
        given = self.dirichlet or self.neumann or self.robin
        if self.exact is None or given:
            return self
        points = _boundary_points(mesh)  # no points on a rank with inner cells only
        if not len(points) or np.abs(self.exact(points)).max() < _ZERO:
            return self
        _log.info("exact is not 0 on this boundary, so it is not the solution: no errors are computed")
        return replace(self, exact=None)


def _boundary_points(mesh: Mesh) -> Float:
    """Return points ``(q, d)`` on the edges of boundary faces: vertices, and two points between."""
    outside = mesh.outer_faces
    sizes = np.diff(mesh.face_offsets)
    onward = np.arange(1, len(mesh.face_vertices) + 1)
    onward[mesh.face_offsets[1:] - 1] = mesh.face_offsets[:-1]
    chosen = np.repeat(outside, sizes)
    ends = mesh.points[mesh.face_vertices[chosen]], mesh.points[mesh.face_vertices[onward[chosen]]]
    return np.concatenate([(1.0 - at) * ends[0] + at * ends[1] for at in (0.0, 0.3, 0.5)])


def constant(source: float = 8.0) -> Diffusion:
    """Return the problem −Δu = f with constant f and u = 0 on the boundary.

    Parameters
    ----------
    source : float
        Constant f. The default 8 belongs to the paper's published counts.
    """
    return Diffusion(source=source)


def sine() -> Diffusion:
    """Return the problem −Δu = f of the paper: u = sin πx sin πy on the unit square, f = 2π² u.

    In 3-D, f = 3π² u with u = sin πx sin πy sin πz on the unit cube.
    """
    return Diffusion(source=_sine_source, exact=_sine)


def _sine(points: Float) -> Float:
    return np.asarray(np.sin(np.pi * points).prod(axis=1))


def _sine_source(points: Float) -> Float:
    return np.asarray(points.shape[1] * np.pi**2 * _sine(points))
