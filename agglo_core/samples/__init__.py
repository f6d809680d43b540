"""Sample meshes, created by functions or from texts such as ``voronoi:n=5000,seed=3``.

The texts cover all samples: the samples of this package and of plugins, components of the kind ``sample``.

>>> from agglo_core import samples
>>> samples.squares(4)
Mesh('squares 4x4', 2-D, 16 cells, 40 faces, 25 points)
>>> samples.from_spec("paper:triangles").n_cells
128
"""

from __future__ import annotations

from agglo_core.samples.brain_head import brain3d
from agglo_core.samples.brain_section import brain, brain_holes
from agglo_core.samples.by_name import from_spec, names
from agglo_core.samples.clouds import random_triangles, voronoi
from agglo_core.samples.layered_ground import layered
from agglo_core.samples.paper_grids import paper
from agglo_core.samples.regular import disconnected, hexagons, ring, squares, strip, triangles
from agglo_core.samples.solid_clouds import random_tetrahedra, voronoi3d
from agglo_core.samples.solids import boxes, prisms, tetrahedra

__all__ = [
    "boxes",
    "brain",
    "brain3d",
    "brain_holes",
    "disconnected",
    "from_spec",
    "hexagons",
    "layered",
    "names",
    "paper",
    "prisms",
    "random_tetrahedra",
    "random_triangles",
    "ring",
    "squares",
    "strip",
    "tetrahedra",
    "triangles",
    "voronoi",
    "voronoi3d",
]
