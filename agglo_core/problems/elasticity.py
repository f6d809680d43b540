"""Linear elasticity: −div σ(u) + c u = f with σ(u) = 2μ ε(u) + λ (div u) I.

As a TOML table, with numbers by cell tag and vectors by boundary tag (no expressions):

.. code-block:: toml

    kind = "elasticity"
    poisson = 0.3                             # a number for all cells,
    [young.material]                          # or one for each value of a cell tag
    1 = 1.0
    2 = 1e3
    [displacement]                            # by value of the face tag "boundary"
    1 = [0.0, 0.0]
    [traction]                                # force per area; faces without entry are free
    2 = [0.0, -1.0]

``lame_lambda`` and ``lame_mu`` may replace ``young`` and ``poisson``, and ``force = [0.0, -9.81]`` is a body
force. ``reaction`` is c >= 0, by default 0, also by cell tag. With neither [displacement] nor [traction],
u = 0 on the whole boundary. With [traction] alone and no reaction, u is determined only up to rigid motions,
and solvers refuse the problem. A first line
``boundary = "gmsh:physical"`` selects another face tag instead of "boundary".
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from agglo_core.arrays import Float, Int, exact_cast, frozen_float, plain_array
from agglo_core.errors import OptionError
from agglo_core.mesh import Mesh
from agglo_core.problems.table import (
    boundary_vectors,
    cell_values,
    face_tag,
    require_by_tag,
    require_keys,
    vector,
)
from agglo_core.suggestions import suggest_keywords

VectorField = Sequence[float] | Float | Callable[[Float], Float]
"""A vector ``(d,)``, one vector per cell ``(n, d)``, or a function of points ``(q, d)`` with values
``(q, d)``."""

_CONSTANTS = ("lame_lambda", "lame_mu", "young", "poisson")
_KEYS = ("boundary", *_CONSTANTS, "reaction", "force", "displacement", "traction")
_BOUNDARY = "boundary"
_YOUNG, _POISSON = 1.0, 0.3


@suggest_keywords()
@dataclass(frozen=True, eq=False)
class Elasticity:
    """Find the displacement u with −div(2μ ε(u) + λ (div u) I) + c u = f, given data by boundary tag.

    In 2-D this is plane strain. The material is isotropic and constant in each cell.

    Attributes
    ----------
    young, poisson : float or (n_cells,) float, optional
        Young's modulus (positive) and Poisson's ratio, between −1 and 1/2. Default: 1 and 0.3.
    force : VectorField
        Body force f. Default: none.
    displacement, traction : mapping of boundary tag value to VectorField
        Boundary values u, and forces per area σ(u) n. If both are empty, u = 0 on the whole boundary.
        Otherwise faces with tags in neither mapping are free, and every domain component needs a tag in
        ``displacement`` or a positive reaction: with tractions alone, u is determined only up to rigid
        motions.
    exact : callable, optional
        Exact solution, if known, for error norms: values ``(q, d)`` at points ``(q, d)``.
    boundary : str
        Face tag with the boundary parts. On a mesh without the tag ``"boundary"``, all faces have
        the value 0.
    lame_lambda, lame_mu : float or (n_cells,) float, optional
        Lamé parameters, instead of ``young`` and ``poisson``; μ and 3λ + 2μ must be positive.
    reaction : float or (n_cells,) float
        Coefficient c, not negative, such as of an elastic bed.

    Raises
    ------
    OptionError
        For data of any other form.

    Examples
    --------
    >>> problem = agglo.Elasticity(young=200.0, poisson=0.25, force=(0.0, -1.0))
    >>> lame_lambda, lame_mu = problem.lame(n_cells=2)
    >>> lame_lambda, lame_mu
    (array([80., 80.]), array([80., 80.]))
    """

    kind: ClassVar[str] = "elasticity"

    young: float | Float | None = None
    poisson: float | Float | None = None
    force: VectorField | None = None
    displacement: Mapping[int, VectorField] = field(default_factory=dict)
    traction: Mapping[int, VectorField] = field(default_factory=dict)
    exact: Callable[[Float], Float] | None = None
    boundary: str = _BOUNDARY
    lame_lambda: float | Float | None = None
    lame_mu: float | Float | None = None
    reaction: float | Float = field(default=0.0, kw_only=True)

    def __post_init__(self) -> None:
        given = [name for name in _CONSTANTS if getattr(self, name) is not None]
        if {*given} & {"lame_lambda", "lame_mu"} and {*given} != {"lame_lambda", "lame_mu"}:
            raise OptionError(
                f"the material needs lame_lambda and lame_mu, or young and poisson; given {', '.join(given)}"
            )
        for name in (*given, "reaction"):
            if callable(getattr(self, name)):
                raise OptionError(
                    f"{name} must be a number or an array with one value per cell, given a callable: give "
                    "its values at mesh.cell_centroids"
                )
            _require_numbers(name, getattr(self, name))
        for name in ("displacement", "traction"):
            require_by_tag(name, getattr(self, name), self.boundary, "vectors")
        vectors = {f"displacement[{tag}]": value for tag, value in self.displacement.items()}
        vectors |= {f"traction[{tag}]": value for tag, value in self.traction.items()}
        for name, value in ({"force": self.force} | vectors).items():
            if value is not None and not callable(value):
                _require_numbers(name, value)
        if self.exact is not None and not callable(self.exact):
            raise OptionError(f"exact must be a callable of points; given {self.exact!r:.60}")

    @classmethod
    def from_table(cls, table: Mapping[str, Any], mesh: Mesh, folder: Path) -> Self:
        """Build the problem from a table. The format is described in :mod:`agglo_core.problems.elasticity`.

        Raises
        ------
        OptionError
            For an unknown or missing key, tag or value, numbers that are not finite, or an impossible
            material.
        """
        require_keys(table, _KEYS)
        empty = [key for key in ("displacement", "traction") if table.get(key) == {}]
        if empty:
            raise OptionError(
                f"[{empty[0]}] is empty: give a vector for each boundary tag, or leave the table out"
            )
        boundary = face_tag("boundary", table.get("boundary", _BOUNDARY), mesh, always=_BOUNDARY)
        displacement = boundary_vectors("displacement", table.get("displacement", {}), mesh, boundary)
        traction = boundary_vectors("traction", table.get("traction", {}), mesh, boundary)
        both = sorted(set(displacement) & set(traction))
        if both:
            raise OptionError(f"boundary tag {both[0]} is in both displacement and traction")
        constants: dict[str, Any] = {
            name: cell_values(name, table[name], mesh) for name in (*_CONSTANTS, "reaction") if name in table
        }
        force = vector("force", table["force"], mesh.dim) if "force" in table else None
        problem = cls(
            force=force, displacement=displacement, traction=traction, boundary=boundary, **constants
        )
        problem.lame(mesh.n_cells)
        problem.reactions(mesh.n_cells)
        return problem

    @classmethod
    def example(cls, mesh: Mesh) -> Self:
        """Return a body under its own weight, clamped on the whole boundary."""
        return cls(force=(*(0.0,) * (mesh.dim - 1), -1.0))

    def lame(self, n_cells: int) -> tuple[Float, Float]:
        """Return the Lamé parameters λ, μ of each cell, two arrays ``(n_cells,)``.

        Raises
        ------
        OptionError
            For a wrong number of values, or a material that is not elastic: names the first such cell.
        """
        if self.lame_mu is not None:
            lame, mu = (_per_cell(name, getattr(self, name), n_cells) for name in ("lame_lambda", "lame_mu"))
            _require("lame_mu must be positive", mu > 0.0, mu)
            bulk = 3.0 * lame + 2.0 * mu
            _require("3 lame_lambda + 2 lame_mu must be positive", bulk > 0.0, bulk)
            return lame, mu
        young = _per_cell("young", _YOUNG if self.young is None else self.young, n_cells)
        nu = _per_cell("poisson", _POISSON if self.poisson is None else self.poisson, n_cells)
        _require("young must be positive", young > 0.0, young)
        _require("poisson must lie between -1 and 0.5, both excluded", (nu > -1.0) & (nu < 0.5), nu)
        mu = young / (2.0 * (1.0 + nu))
        return frozen_float(2.0 * mu * nu / (1.0 - 2.0 * nu)), frozen_float(mu)

    def reactions(self, n_cells: int) -> Float:
        """Return the reaction of each cell ``(n_cells,)``.

        Raises
        ------
        OptionError
            For a wrong number of values, or a negative value: names the first such cell.
        """
        values = _per_cell("reaction", self.reaction, n_cells)
        _require("reaction must not be negative", values >= 0.0, values)
        return values

    def stress(self, gradients: Float, cells: Int, n_cells: int) -> Float:
        """Return the stresses 2μ ε + λ (tr ε) I of displacement gradients, σ_zz of plane strain included.

        Parameters
        ----------
        gradients : (q, d, d) float
            ∂u_i/∂x_j.
        cells : (q,) int
            Cell of each gradient.
        n_cells : int
            Number of cells of the mesh.

        Returns
        -------
        (q, 3, 3) float

        Examples
        --------
        >>> import numpy as np
        >>> stretched = np.array([[[0.1, 0.0], [0.0, 0.0]]])
        >>> agglo.Elasticity(lame_lambda=2.0, lame_mu=1.0).stress(stretched, np.array([0]), 1).round(2)
        array([[[0.4, 0. , 0. ],
                [0. , 0.2, 0. ],
                [0. , 0. , 0.2]]])
        """
        lame, mu = (each[cells, None, None] for each in self.lame(n_cells))
        dim = gradients.shape[1]
        strain = np.zeros((len(gradients), 3, 3))
        strain[:, :dim, :dim] = 0.5 * (gradients + gradients.transpose(0, 2, 1))
        trace = np.trace(strain, axis1=1, axis2=2)[:, None, None]
        return frozen_float(2.0 * mu * strain + lame * trace * np.eye(3))


def _require_numbers(name: str, value: Any) -> None:
    exact_cast(plain_array(value, name, OptionError), np.float64, name, OptionError)


def _per_cell(name: str, value: Any, n_cells: int) -> Float:
    values = np.asarray(value, float)
    if values.shape not in ((), (n_cells,)):
        raise OptionError(f"{name} has shape {values.shape}: expected a number or ({n_cells},) values")
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        raise OptionError(f"{name} is {values.flat[bad[0]]} in cell {bad[0]}, not finite")
    return frozen_float(np.broadcast_to(values, (n_cells,)))


def _require(rule: str, ok: Any, values: Float) -> None:
    bad = np.flatnonzero(~ok)
    if len(bad):
        raise OptionError(f"{rule}: it is {values[bad[0]]:g} in cell {bad[0]}")
