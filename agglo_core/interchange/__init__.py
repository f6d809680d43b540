"""Convert meshes, graphs and levels to objects and files of other packages, and back.

Each function imports the other package when it is called.

>>> from agglo_core import interchange, samples
>>> mesh = samples.squares(4)
>>> interchange.mesh_from_shapely(interchange.mesh_to_shapely(mesh)).n_cells
16
"""

from __future__ import annotations

from agglo_core.interchange.geojson import from_geojson, to_geojson
from agglo_core.interchange.metis_read import graph_from_metis, parts_from_metis
from agglo_core.interchange.metis_write import graph_to_metis, parts_to_metis
from agglo_core.interchange.networkx_graphs import graph_from_networkx, graph_to_networkx
from agglo_core.interchange.pyvista_grids import to_pyvista
from agglo_core.interchange.scotch_read import graph_from_scotch, parts_from_scotch
from agglo_core.interchange.shapely_in import mesh_from_shapely
from agglo_core.interchange.shapely_out import mesh_to_shapely

__all__ = [
    "from_geojson",
    "graph_from_metis",
    "graph_from_networkx",
    "graph_from_scotch",
    "graph_to_metis",
    "graph_to_networkx",
    "mesh_from_shapely",
    "mesh_to_shapely",
    "parts_from_metis",
    "parts_from_scotch",
    "parts_to_metis",
    "to_geojson",
    "to_pyvista",
]
