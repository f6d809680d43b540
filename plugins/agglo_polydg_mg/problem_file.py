"""Problems by name or from a TOML file: numbers by cell tag and boundary tag, no expressions.

.. code-block:: toml

    source = 1.0                              # a number for all cells,
    [kappa.material]                          # or one for each value of a cell tag
    1 = 1.0
    2 = 1e6
    [dirichlet]                               # by value of the face tag "boundary"
    1 = 0.0
    [neumann]                                 # outward flux κ ∂u/∂n; faces without entry are insulated
    2 = 1.0

κ and source are 1 unless given. With neither [dirichlet] nor [neumann] u = 0 on the whole boundary;
[neumann] alone leaves u known up to a constant only, and is refused by the solver. A first line
``boundary = "gmsh:physical"`` names another face tag of the mesh in place of "boundary".
"""

from __future__ import annotations

import logging
import sys
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from agglo_core.arrays import Float, frozen_float
from agglo_core.errors import FileError
from agglo_core.mesh import Mesh
from agglo_core.problems import Diffusion

__all__ = ["NAMED", "named_problem", "read_problem"]

NAMED = ("constant", "sine")
_KEYS = ("boundary", "kappa", "source", "dirichlet", "neumann")
_BOUNDARY = "boundary"
_LARGEST = sys.float_info.max
_log = logging.getLogger("agglo")


def named_problem(name: str, mesh: Mesh) -> tuple[Diffusion, Mesh]:
    """A problem of u = 0 on the boundary, by name, or of a TOML file; and the mesh it belongs to.

    ``constant`` has f = 8, the source of the paper's published counts; ``sine`` has
    f = 2π² sin πx sin πy, that of its text, with the solution sin πx sin πy on the unit square.

    Raises
    ------
    FileError
        As :func:`read_problem`, if it is none of the names.
    """
    if name == "constant":
        return Diffusion(source=8.0), mesh
    if name != "sine":
        return read_problem(Path(name), mesh)
    known = _vanishes_on_boundary(mesh)
    if not known:
        _log.info(
            "sin πx sin πy is not 0 on this boundary, so the solution is not known: no errors are given"
        )
    return Diffusion(source=_sine_source, exact=_sine if known else None), mesh


def _sine(points: Float) -> Float:
    return np.asarray(np.sin(np.pi * points[:, 0]) * np.sin(np.pi * points[:, 1]))


def _sine_source(points: Float) -> Float:
    return 2.0 * np.pi**2 * _sine(points)


def _vanishes_on_boundary(mesh: Mesh) -> bool:
    ends = mesh.points[mesh.face_pairs[mesh.face_cells[:, 1] < 0]]
    at = np.array([0.0, 0.3, 0.5])[:, None, None]
    along = (1.0 - at) * ends[:, 0] + at * ends[:, 1]
    return bool(np.abs(_sine(along.reshape(-1, 2))).max() < 1e-9)


def read_problem(path: Path, mesh: Mesh) -> tuple[Diffusion, Mesh]:
    """Read a diffusion problem for ``mesh``, and give it back with the face tag "boundary" of the problem.

    Raises
    ------
    FileError
        If the file cannot be read; names a key, tag or value that does not exist or is lacking; holds
        anything but finite numbers, or a coefficient that is not positive.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise FileError(f"{path}: {_unreadable(error)}") from None
    unknown = sorted(set(table) - set(_KEYS))
    if unknown:
        raise FileError(f"{path}: unknown key {unknown[0]!r}; accepted: {', '.join(_KEYS)}")
    empty = [key for key in ("dirichlet", "neumann") if table.get(key) == {}]
    if empty:
        raise FileError(f"{path}: [{empty[0]}] is empty: give a number by boundary tag, or leave it out")
    mesh = _with_boundary(path, table.get("boundary", _BOUNDARY), mesh)
    dirichlet = _boundary_values(path, "dirichlet", table.get("dirichlet", {}), mesh)
    neumann = _boundary_values(path, "neumann", table.get("neumann", {}), mesh)
    both = sorted(set(dirichlet) & set(neumann))
    if both:
        raise FileError(f"{path}: boundary tag {both[0]} stands in dirichlet and in neumann")
    kappa = _cell_values(path, "kappa", table.get("kappa", 1.0), mesh)
    if np.min(kappa) <= 0.0:
        raise FileError(f"{path}: kappa must be positive, given {np.min(kappa):g}")
    source = _cell_values(path, "source", table.get("source", 1.0), mesh)
    return Diffusion(kappa=kappa, source=source, dirichlet=dirichlet, neumann=neumann), mesh


def _unreadable(error: Exception) -> str:
    if isinstance(error, FileNotFoundError):
        return f"no such file, and no problem of that name ({', '.join(NAMED)})"
    if isinstance(error, IsADirectoryError):
        return f"a folder; a problem is a .toml file or a name ({', '.join(NAMED)})"
    return str(error.strerror or error) if isinstance(error, OSError) else str(error)


def _with_boundary(path: Path, name: Any, mesh: Mesh) -> Mesh:
    """The mesh, its face tag ``name`` being the one that is called "boundary"."""
    if name == _BOUNDARY:
        return mesh
    if not isinstance(name, str) or name not in mesh.face_tags:
        raise FileError(f"{path}: boundary must be a face tag of the mesh, given {name!r}; {_tags_of(mesh)}")
    return replace(mesh, face_tags={**mesh.face_tags, _BOUNDARY: mesh.face_tags[name]})


def _tags_of(mesh: Mesh) -> str:
    return f"it has the face tags: {', '.join(mesh.face_tags) or 'none'}"


def _cell_values(path: Path, key: str, given: Any, mesh: Mesh) -> float | Float:
    """A number, or one for each cell ``(n_cells,)`` from a table by tag and value."""
    if not isinstance(given, Mapping):
        return _number(path, key, given)
    if len(given) != 1:
        raise FileError(f"{path}: {key} must name one cell tag, given {', '.join(given) or 'none'}")
    ((tag, values),) = given.items()
    if tag not in mesh.cell_tags or not isinstance(values, Mapping):
        known = ", ".join(mesh.cell_tags) or "none"
        raise FileError(f"{path}: {key}.{tag} must be a table by a cell tag of the mesh; it has: {known}")
    cells = mesh.cell_tags[tag]
    by_value = _by_whole(path, f"{key}.{tag}", values)
    present, place = np.unique(cells, return_inverse=True)
    lacking = [int(each) for each in present if int(each) not in by_value]
    if lacking:
        raise FileError(f"{path}: {key}.{tag} has no number for {', '.join(map(str, lacking))}")
    foreign = sorted(set(by_value) - set(present.tolist()))
    if foreign:
        known = ", ".join(map(str, present[:20]))
        raise FileError(
            f"{path}: {key}.{tag} speaks of {foreign[0]}; the tag's values in the mesh are: {known}"
        )
    return frozen_float(np.array([by_value[int(each)] for each in present])[place])


def _boundary_values(path: Path, key: str, given: Any, mesh: Mesh) -> dict[int, float]:
    if not isinstance(given, Mapping):
        raise FileError(f"{path}: {key} must be a table by boundary tag, given {given!r:.60}")
    outside = mesh.face_cells[:, 1] < 0
    tags = mesh.face_tags.get(_BOUNDARY, np.zeros(mesh.n_faces, np.int64))
    present = sorted({int(each) for each in np.unique(tags[outside])})
    values = _by_whole(path, key, given)
    for tag in values:
        if tag not in present:
            known = f"{', '.join(map(str, present))} ({_tags_of(mesh)})"
            raise FileError(f"{path}: {key} speaks of boundary tag {tag}; the mesh has: {known}")
    return values


def _by_whole(path: Path, key: str, given: Mapping[str, Any]) -> dict[int, float]:
    """Numbers by the value of a tag, each of which is written once."""
    values: dict[int, float] = {}
    for name, value in given.items():
        tag = _whole(path, key, name)
        if tag in values:
            raise FileError(f"{path}: {key} gives tag {tag} twice")
        values[tag] = _number(path, f"{key}.{name}", value)
    return values


def _whole(path: Path, key: str, name: str) -> int:
    try:
        return int(name)
    except ValueError:
        raise FileError(f"{path}: {key}: {name!r} is not the value of a tag, a whole number") from None


def _number(path: Path, key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= _LARGEST:
        raise FileError(f"{path}: {key} must be a finite number, given {value!r:.60}")
    return float(value)
