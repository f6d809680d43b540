"""Choose the method of the default solver from mesh, penalty, coefficient and degree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from agglo_core.authoring import Float, Mesh, OptionError, solvers
from agglo_polydg_mg.auxiliary.strong_faces import columns, flat_part, shape_penalty, strong_part, weak_part

RECIPES: Final = ("auto", "conforming", "patches", "agglomerates")
CYCLES: Final = ("auto", "V", "W", "F", "K")
PRECISIONS: Final = ("auto", "single", "double")

BAD: Final = 0.06
"""Fraction of strong faces above which polygons and polyhedra are bad: slivers, boundary layers
(benchmarks/solve.py --meshes voronoi random graded layers)."""
_BAD_SOLID: Final = 0.03
"""Corresponding fraction for tetrahedra and hexahedra: on slivers the continuous space loses conjugacy
(benchmarks/solve.py --meshes tetrahedra slivers)."""
_UNEASY: Final = 0.01
"""Fraction of strong faces above which high degrees converge faster on vertex patches, at no extra cost
(benchmarks/solve.py --meshes triangles random --degrees 3)."""
_LAYERS: Final = 0.02
"""Fraction of weak faces above which a mesh has layers of flat cells (benchmarks/solve.py --meshes graded
layers)."""
_FLAT: Final = {2: 0.05, 3: 0.001}
"""Measure over the power d of the diameter, below which a cell is flat, by dimension. In 2-D with varying κ,
a tenth: patches are then better on flatter cells only (benchmarks/solve.py --meshes squeezed wedges)."""
_FLAT_CELLS: Final = 0.01
"""Fraction of flat cells above which a mesh is flat (benchmarks/solve.py --meshes squeezed wedges)."""
_CUT: Final = 0.05
"""Fraction of strong pairs of cells between columns, up to which columns are smoothed instead of vertex
patches (benchmarks/solve.py --meshes squeezed wedges)."""
_SMOOTH: Final = 100.0
"""Ratio κ_max / κ_min up to which aggregates serve as well as classical levels (benchmarks/solve.py --meshes
voronoi halves checks --degrees 1)."""
_DIRECTIONAL: Final = 10.0
"""Ratio of the eigenvalues of a tensor above which its direction matters (benchmarks/elliptic.py --rows
ε)."""
_CONTRAST: Final = 1e8
"""Ratio κ_max / κ_min above which cycles run in double precision, which takes more time and memory than
single precision, but keeps sixteen digits instead of seven."""
_TETRAHEDRON, _QUADRILATERAL, _HEXAHEDRON = 4, 4, 6  # faces
_SINGLE: Final = (1e-33, 1e35)
"""Range of diagonal entries that leaves single precision room for products and sums."""


@dataclass(frozen=True)
class Overrides:
    """The user's choices. The default ``"auto"`` leaves a choice to the solver."""

    recipe: str = "auto"
    cycle: str = "auto"
    precision: str = "auto"


@dataclass(frozen=True)
class Plan:
    """Plan of the multigrid levels for a system: coarse spaces, smoother, cycle and precision.

    Attributes
    ----------
    recipe : "conforming", "patches" or "agglomerates"
        A continuous space below the discontinuous space, or polynomials on agglomerates, smoothed by vertex
        patches or cell by cell.
    cycle : "V", "W", "F" or "K"
    dtype : numpy dtype
        Cycle precision.
    smoother : "cells", "groups" or "patches"
        Smoother on the first level: block Gauss–Seidel on single cells, on groups of up to eight cells
        joined by strong couplings (in 3-D on columns of flat cells), or on the cells around each vertex.
    bubbles : bool
        Whether the continuous space has bubbles.
    vertices : "aggregates" or "classical"
        Coarsening of the vertex problem.
    layers : bool
        Whether classical levels need a guide: in flat cells vertex couplings have either sign.
    directional : bool
        Whether vertex patches extend along the strong direction of a tensor.
    strong : float
        Fraction of the inner faces that are strong.
    reason : str
        The plan in words.
    kind : "cells", "groups" or "solids"
        Kind of system for the solver advice.
    """

    recipe: Literal["conforming", "patches", "agglomerates"]
    cycle: Literal["V", "W", "F", "K"]
    dtype: Any
    smoother: Literal["cells", "groups", "patches"]
    bubbles: bool
    vertices: Literal["aggregates", "classical"]
    layers: bool
    directional: bool
    strong: float
    reason: str
    kind: solvers.Kind


def choose(
    mesh: Mesh,
    sigma: Float,
    kappa: Float,
    degree: int,
    overrides: Overrides = Overrides(),
    diagonal: Float | None = None,
    tensors: Float | None = None,
) -> Plan:
    """Choose coarse spaces, smoother and cycle for a symmetric interior penalty system.

    A face is *strong* if its penalty is more than 3 times the smallest penalty in one of its cells, and
    *weak* if in both cells a jump costs less than 0.1 times its cost at another face. More than 6 % strong
    faces make a mesh *bad* (slivers, boundary layers); the limit is 3 % for tetrahedra and hexahedra. More
    than 2 % weak faces make *layers* in meshes of triangles and quadrilaterals. A cell is *flat* if its area
    is below 0.05 d², its volume below 0.001 d³ (d: diameter), and a mesh is *flat* with more than 1 % flat
    cells; polygons where κ varies are flat from a tenth of this. κ is *directional* if its eigenvalues
    differ by more than a factor of 10 in more than 6 % of the cells; |F| / |T| of a face F with its smaller
    cell T then replaces the penalty in the test of layers. The flat cells form *columns* if groups of up to
    64 cells separate at most 5 % of the cell pairs with a strong face. κ *varies* if it spans more than two
    decades.

    =====================================================  ============  ========  ==========  =====
    case                                                   recipe        smoother  vertices    cycle
    =====================================================  ============  ========  ==========  =====
    2-D, p = 1, otherwise                                  conforming    cells     aggregates  W
    2-D, p = 1, layers, or κ varies                        conforming    cells     classical   V
    2-D, p = 1, bad                                        conforming    groups    classical   V
    2-D, p > 1, otherwise                                  conforming    cells     classical   V
    2-D, p > 1, bad                                        conforming    patches   classical   V
    2-D, p > 2, polygons, or more than 1 % strong          conforming    patches   classical   V
    2-D, polygons, flat                                    patches       patches               W
    2-D, polygons, p > 1, κ directional                    patches       patches               W
    3-D, tetrahedra, p = 1                                 conforming    cells     aggregates  W
    3-D, tetrahedra to hexahedra, otherwise                conforming    cells     aggregates  V
    3-D, tetrahedra to hexahedra, bad, flat, or κ varies   patches       patches               W
    3-D, tetrahedra to hexahedra, flat columns             conforming    groups    aggregates  V
    3-D, polyhedra                                         agglomerates  cells                 V
    3-D, polyhedra, bad, or flat                           patches       patches               W
    =====================================================  ============  ========  ==========  =====

    Aggregates are cheap but slow alone, hence the W-cycle. Classical levels are robust against jumping or
    directional couplings, but their matrices are fuller; in layers the couplings inside cells guide them.
    Where several rows of the table apply, the last one does.
    If κ is directional, vertex patches extend along it.
    Polygons have no bubbles unless the mesh is bad, and polyhedra have none, because bubbles would be too
    many. The cycle runs in single precision unless κ spans more than eight decades or the matrix diagonal
    exceeds its range. ``overrides`` replace recipe, cycle and precision.

    Parameters
    ----------
    mesh : Mesh
    sigma : (n_faces,) float
        Penalty in 1 / length; 0 on natural faces.
    kappa : (n_cells,) float
    degree : int
        p.
    overrides : Overrides
    diagonal : (n,) float, optional
        Matrix diagonal.
    tensors : (n_cells, d, d) float, optional
        Tensor coefficient per cell; without it κ is a scalar.

    Raises
    ------
    OptionError
        For the recipe ``"agglomerates"`` in 2-D.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core import samples
    >>> from agglo_polydg_mg.forms.penalty import face_penalty
    >>> from agglo_polydg_mg.solver.choose import choose
    >>> mesh = samples.squares(4)
    >>> plan = choose(mesh, face_penalty(mesh, 1), np.ones(16), 1)
    >>> plan.smoother, plan.vertices, plan.cycle
    ('cells', 'aggregates', 'W')
    """
    if overrides.recipe == "agglomerates" and mesh.dim == 2:
        raise OptionError(
            "recipe 'agglomerates' is for linear systems and 3-D meshes; for diffusion in 2-D use "
            "recipe='auto'"
        )
    # 1. Choose by the table, from mesh and coefficient
    strong, contrast = strong_part(mesh, sigma), float(kappa.max() / kappa.min())
    directional, varies = mesh.dim == 2 and _is_directional(tensors), contrast > _SMOOTH
    if mesh.dim == 2:
        row = _row_in_plane(mesh, sigma, strong, varies, degree, directional)
    else:
        row = _row_of_solids(mesh, sigma, strong, varies, degree)
    recipe, smoother, cycle, bubbles, aggregates, layers, flat = row
    # 2. Apply the user's choices
    if overrides.recipe != "auto":
        recipe = overrides.recipe
    if recipe != "conforming":
        smoother = "patches" if recipe == "patches" else "cells"
    if overrides.cycle != "auto":
        cycle = overrides.cycle
    elif recipe == "patches":
        cycle = "W"
    # 3. Choose the precision
    in_range = diagonal is None or (diagonal.min() > _SINGLE[0] and diagonal.max() < _SINGLE[1])
    single = contrast <= _CONTRAST and in_range
    if overrides.precision != "auto":
        single = overrides.precision == "single"
    dtype: Any = np.float32 if single else np.float64
    # 4. Describe the plan in words
    coarse = "continuous space and " + ("its aggregates" if aggregates else "classical levels")
    levels = coarse if recipe == "conforming" else "smoothed agglomerates"
    most_faces = int(np.diff(mesh.cell_faces[0]).max())
    details = f"{100 * strong:.0f} % strong faces, at most {most_faces} faces a cell"
    if flat > _FLAT_CELLS:
        details += f", {100 * flat:.0f} % flat cells"
    if directional:
        details += ", directional kappa"
    kind: solvers.Kind = "cells" if smoother == "cells" and bubbles else "groups"
    return Plan(
        recipe,
        cycle,
        dtype,
        smoother,
        bubbles,
        "aggregates" if aggregates else "classical",
        layers,
        directional,
        strong,
        f"{levels}, {smoother}, {cycle}-cycle, {np.dtype(dtype).name} ({details})",
        "solids" if mesh.dim == 3 else kind,
    )


class _Row(NamedTuple):
    """Row of the table for a mesh: fields of the plan, and the fraction of flat cells."""

    recipe: Any
    smoother: Any
    cycle: Any
    bubbles: bool
    aggregates: bool
    layers: bool
    flat: float


def _is_directional(tensors: Float | None) -> bool:
    """Return True if the eigenvalues of tensors differ by more than 10 in more than 6 % of the cells."""
    if tensors is None:
        return False
    values = np.linalg.eigvalsh(tensors)
    return bool(np.mean(values[:, -1] > _DIRECTIONAL * values[:, 0]) > BAD)


def _row_in_plane(
    mesh: Mesh, sigma: Float, strong: float, varies: bool, degree: int, directional: bool
) -> _Row:
    """Return the row of the table for a 2-D mesh."""
    faces_per_cell = np.diff(mesh.cell_faces[0])
    polygons = bool(faces_per_cell.max() > _QUADRILATERAL)
    few_polygons = bool(np.mean(faces_per_cell > _QUADRILATERAL) < 0.5)
    bad = strong > BAD
    layers = few_polygons and weak_part(mesh, shape_penalty(mesh) if directional else sigma) > _LAYERS
    aggregates = degree == 1 and not (bad or layers or varies)
    smoother = "cells"
    if bad or (degree > 2 and (polygons or strong > _UNEASY)):
        smoother = "patches" if degree > 1 else "groups"
    flat = 0.0 if few_polygons else flat_part(mesh, _FLAT[2] * (0.1 if varies else 1.0), _FLAT_CELLS)
    along = directional and degree > 1 and not few_polygons
    recipe = "patches" if flat > _FLAT_CELLS or along else "conforming"
    return _Row(recipe, smoother, "W" if aggregates else "V", bad or not polygons, aggregates, layers, flat)


def _row_of_solids(mesh: Mesh, sigma: Float, strong: float, varies: bool, degree: int) -> _Row:
    """Return the row of the table for a 3-D mesh."""
    faces_per_cell = np.diff(mesh.cell_faces[0])
    polyhedra = bool(np.mean(faces_per_cell > _HEXAHEDRON) > 0.5)
    flat = flat_part(mesh, _FLAT[3])
    if flat > _FLAT_CELLS and not polyhedra and columns(mesh)[1] <= _CUT:
        return _Row("conforming", "groups", "V", True, True, False, flat)
    bad = strong > BAD if polyhedra else strong > _BAD_SOLID or varies
    bad = bad or flat > _FLAT_CELLS
    recipe = "patches" if bad else "agglomerates" if polyhedra else "conforming"
    cycle = "W" if degree == 1 and faces_per_cell.max() == _TETRAHEDRON else "V"
    return _Row(recipe, "patches" if bad else "cells", cycle, not polyhedra, not varies, False, flat)
