"""Format ``toy``."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

from agglo_core.authoring import FileError, Hierarchy, Mesh, MeshError

__all__ = ["Toy"]


class Toy:
    """JSON file with points, vertex loops and cell tags, for 2-D meshes without holes and hierarchies."""

    lossless = False

    def read(self, path: Path) -> Mesh:
        """Return the mesh of a file."""
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
            return Mesh.from_polygons(found["points"], found["cells"], cell_tags=found["tags"])
        except (ValueError, KeyError, TypeError) as error:
            raise FileError(f"{path}: is no toy file: {error!r}") from error

    def write(self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        """Write the mesh."""
        if mesh.dim != 2 or len(mesh.boundary_loops.loop_offsets) != mesh.n_cells + 1 or hierarchy:
            raise MeshError(f"{path}: a toy file holds cells of the plane without holes, and no hierarchy")
        vertices, starts = mesh.boundary_loops.vertices.tolist(), mesh.boundary_loops.loop_offsets.tolist()
        cells = [vertices[i:j] for i, j in pairwise(starts)]
        tags = {name: tag.tolist() for name, tag in mesh.cell_tags.items()}
        text = json.dumps({"points": mesh.points.tolist(), "cells": cells, "tags": tags})
        path.write_text(text, encoding="utf-8")
