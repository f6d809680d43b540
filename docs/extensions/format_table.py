"""Table of the data that each file format preserves, found by writing and reading small meshes.

The table shows for each format the supported cells, tags and labels, and losses or refusals. It is part of
``docs/reference/formats.md``, and printed by ``python docs/extensions/format_table.py``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from agglo_core import samples
from agglo_core.arrays import frozen_float, frozen_int
from agglo_core.conformance.base.own_components import own_components
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.drawn import drawn_labels
from agglo_core.errors import AggloError, PluginError
from agglo_core.hierarchy import Hierarchy
from agglo_core.io import read, read_hierarchy, write
from agglo_core.mesh import Mesh

BEGIN = "<!-- written by `python docs/extensions/format_table.py` -->"
END = "<!-- end of the generated table -->"

FOREIGN = (".vtk", ".msh", ".avs", ".mesh", ".su2")
"""Suffixes of meshlane with an own row in the table."""

_ARRAYS = ("points", "face_offsets", "face_vertices", "face_cells")
_NAME = "a name, 50 %"
_CLASSES = {
    "2-D cells": ("polygons", "triangles", "quadrilaterals"),
    "3-D cells": ("polyhedra", "tetrahedra", "hexahedra"),
}
_RICH = (
    "quadrilaterals",
    "triangles",
    "hexahedra",
    "tetrahedra",
    "holes",
    "polyhedra",
    "polygons",
)  # in increasing order of priority: tags are tried with the last supported shape
_COLUMNS = ("lossless", "2-D cells", "holes", "3-D cells", "digits", "numbering", "cell tags", "any name",
            "outer faces", "inner faces", "labels", "targets", "coarse meshes")  # fmt: skip


def format_names() -> list[tuple[str, str]]:
    """List each built-in format with its first suffix.

    Meshlane has a row per suffix in :data:`FOREIGN`.
    """
    names = [record.name for record in own_components().list() if record.kind == "format"]
    first = {name: FOREIGN if name == "meshlane" else _suffixes(name)[:1] for name in names}
    return [(name, suffix) for name in names for suffix in first[name]]


def _suffixes(name: str) -> tuple[str, ...]:
    """Return a built-in format's suffixes."""
    component = own_components().record("format", name).component
    return component.suffixes if component is not None else ()


def format_table() -> str:
    """Return the Markdown table of all formats, between the begin and end marks."""
    rows = [format_row(name, suffix) for name, suffix in format_names()]
    head = ["files", "format", *_COLUMNS]
    lines = [_line(head), _line(["---"] * len(head)), *rows]
    return "\n".join((BEGIN, "", *lines, "", END))


def format_row(name: str, suffix: str) -> str:
    """Return the table row of a file format, or of one suffix of the format ``meshlane``.

    Raises
    ------
    PluginError
        If the format cannot be used here.
    """
    record = own_components().record("format", name)
    if record.state != "ok":
        raise PluginError(f"format {name!r}: {record.reason}")
    files = [suffix] if name == "meshlane" else _suffixes(name)
    suffixes = " ".join(f"`{s}`" for s in files)
    outcomes = round_trips(suffix)
    answers = outcomes or {"lossless": "only read"}
    return _line([suffixes, f"`{name}`", *(answers.get(column, "") for column in _COLUMNS)])


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def round_trips(suffix: str) -> dict[str, str] | None:
    """Write and read test meshes with this suffix, and return the table entry of each column.

    Return None if the format is read-only.

    ``yes`` means that the data came back, ``lost`` that they did not, and ``refused`` that writing raised
    an error. Cell columns list the cell types that came back. Coarse meshes are ``yes`` if they are written
    to files of their own; the labels hold the same information.
    """
    # Write every shape, then test tags, labels and digits on the richest shape that came back.
    shapes = {shape: _try_trip(partial(_shape, mesh, suffix)) for shape, mesh in _shapes().items()}
    intact_shapes = [shape for shape, answer in shapes.items() if answer == "yes"]
    if not intact_shapes:
        return None
    mesh = _shapes()[max(intact_shapes, key=_RICH.index)]
    answers = {name: _try_trip(partial(trait, mesh, suffix)) for name, trait in _TRAITS.items()}
    answers["holes"] = shapes["holes"]
    for column, (whole, *parts) in _CLASSES.items():
        some = ", ".join(part for part in parts if part in intact_shapes)
        answers[column] = whole if whole in intact_shapes else some or shapes[parts[0]]
    answers["coarse meshes"] = "yes" if answers["coarse meshes"] == "yes" else "no"
    answers["lossless"] = "no" if {"lost", "refused"} & set(answers.values()) else "yes"
    return answers


def _try_trip(trip: Callable[[], bool]) -> str:
    try:
        return "yes" if trip() else "lost"
    except PluginError:
        raise
    except AggloError:
        return "refused"


def _shapes() -> dict[str, Mesh]:
    """Return a test mesh for each cell type, with coordinates that need all decimal digits."""
    around = np.ones((5, 5), int)
    around[1:4, 1:4] = 0
    whole = {
        "triangles": samples.triangles(4),
        "quadrilaterals": small_meshes.grid(4, 3),
        "polygons": small_meshes.grid(4, 3).coarsen(frozen_int([0, 0, 0, 1, 0, 2, 2, 1, 3, 3, 1, 1])),
        "holes": small_meshes.grid(5, 5).coarsen(frozen_int(around.ravel())),
        "tetrahedra": samples.tetrahedra(1),
        "hexahedra": small_meshes.boxes(3, 2, 2),
        "polyhedra": small_meshes.boxes(3, 2, 2).coarsen(frozen_int([0, 0, 1, 0, 1, 1, 2, 2, 3, 2, 3, 3])),
    }
    return {
        name: replace(mesh, points=frozen_float(mesh.points / 3), name="") for name, mesh in whole.items()
    }


def _read_back(mesh: Mesh, suffix: str) -> Mesh:
    with TemporaryDirectory() as folder:
        file = Path(folder) / f"m{suffix}"
        write(file, mesh)
        return read(file)


def _shape(mesh: Mesh, suffix: str) -> bool:
    back = _read_back(mesh, suffix)
    if (back.dim, back.n_cells) != (mesh.dim, mesh.n_cells):
        return False
    links = abs(back.graph.to_scipy() - mesh.graph.to_scipy())
    alike = np.allclose(back.cell_measures, mesh.cell_measures, rtol=1e-9)
    return bool(alike and links.max() < 1e-9)


def _digits(mesh: Mesh, suffix: str) -> bool:
    points_before, points_after = (
        m.points[np.unique(m.face_vertices)] for m in (mesh, _read_back(mesh, suffix))
    )
    return np.array_equal(
        points_before[np.lexsort(points_before.T)], points_after[np.lexsort(points_after.T)]
    )


def _numbering(mesh: Mesh, suffix: str) -> bool:
    back = _read_back(mesh, suffix)
    return all(np.array_equal(getattr(mesh, name), getattr(back, name)) for name in _ARRAYS)


def _tags(name: str, mesh: Mesh, suffix: str) -> bool:
    values = np.arange(mesh.n_cells) % 3 - 1
    cell_tags = _read_back(replace(mesh, cell_tags={name: values}), suffix).cell_tags
    return name in cell_tags and np.array_equal(cell_tags[name], values)


def _faces(outer: bool, mesh: Mesh, suffix: str) -> bool:
    """Return True if a tag on outer or on inner faces is preserved by writing and reading.

    Faces are identified by their centroids.
    """
    tagged_faces = np.flatnonzero((mesh.face_cells[:, 1] < 0) == outer)[::2]
    tag = np.zeros(mesh.n_faces, np.int64)
    tag[tagged_faces] = 1
    mesh = replace(mesh, face_tags={"inlet": tag})
    back = _read_back(mesh, suffix)
    if "inlet" not in back.face_tags:
        return False
    centroids_before, centroids_after = (m.face_centroids[m.face_tags["inlet"] == 1] for m in (mesh, back))
    direction = np.sqrt([2.0, 3.0, 5.0])[: mesh.dim]  # a direction along which no two faces coincide
    return len(centroids_before) == len(centroids_after) and np.allclose(
        np.sort(centroids_before @ direction), np.sort(centroids_after @ direction)
    )


def _levels(mesh: Mesh, suffix: str) -> tuple[Hierarchy, Hierarchy | None, bool]:
    """Return a hierarchy, its copy read from a file, and True if its coarse mesh has a file of its own."""
    labels = drawn_labels(mesh.graph, "strips", 2)
    hierarchy = Hierarchy(mesh, mesh.graph, [labels], [{"h_star": 0.5}], nested=True)
    with TemporaryDirectory() as folder:
        file = Path(folder) / f"m{suffix}"
        write(file, mesh, hierarchy)
        coarse_file = Path(folder) / f"m_level0{suffix}"
        coarse = coarse_file.exists() and _same_cells(read(coarse_file), hierarchy.mesh(0))
        return hierarchy, read_hierarchy(file)[1], coarse


def _same_cells(mesh: Mesh, other: Mesh) -> bool:
    return mesh.n_cells == other.n_cells and np.allclose(mesh.cell_measures, other.cell_measures)


def _labels(mesh: Mesh, suffix: str) -> bool:
    hierarchy, copy, _ = _levels(mesh, suffix)
    return copy is not None and np.array_equal(copy.levels[0], hierarchy.levels[0])


def _targets(mesh: Mesh, suffix: str) -> bool:
    hierarchy, copy, _ = _levels(mesh, suffix)
    return copy is not None and list(copy.targets) == list(hierarchy.targets)


def _coarse(mesh: Mesh, suffix: str) -> bool:
    return _levels(mesh, suffix)[2]


_TRAITS: Mapping[str, Callable[[Mesh, str], bool]] = {
    "digits": _digits,
    "numbering": _numbering,
    "cell tags": partial(_tags, "rock"),
    "any name": partial(_tags, _NAME),
    "outer faces": partial(_faces, True),
    "inner faces": partial(_faces, False),
    "labels": _labels,
    "targets": _targets,
    "coarse meshes": _coarse,
}


if __name__ == "__main__":
    sys.stdout.write(f"{format_table()}\n")
