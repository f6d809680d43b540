"""Read and write mesh files.

The suffix selects the format.

:func:`read` returns a mesh, :func:`read_hierarchy` also the stored hierarchy, and :func:`write` writes both;
:mod:`agglo_core` re-exports all three. Formats are components (kind ``format``,
:class:`~agglo_core.protocols.Format`), built in or from plugins. The built-in classes are :class:`Vtu`,
:class:`Npz`, :class:`Meshlane` and :class:`OpenFoam`.
"""

from __future__ import annotations

import os
import sys
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from agglo_core.errors import FileError, OptionError
from agglo_core.files.regular import check_regular
from agglo_core.io.file_checks import name_in_errors, read_by, read_hierarchy_by, write_by
from agglo_core.io.formats import Formats, KnownFormat
from agglo_core.progress import Listener, followed, labelled, phase, unwrapped
from agglo_core.registry import Registry, default
from agglo_core.suggestions import suggest_keywords

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.io.foreign.meshlane import Meshlane
    from agglo_core.io.levels import LevelValues
    from agglo_core.io.npz import Npz
    from agglo_core.io.openfoam.format import OpenFoam
    from agglo_core.io.vtk.vtu import Vtu
    from agglo_core.mesh import Mesh

__all__ = ["Meshlane", "Npz", "OpenFoam", "Vtu", "check_writable", "read", "read_hierarchy", "write"]

_CLASSES = {
    "Meshlane": "agglo_core.io.foreign.meshlane",
    "Npz": "agglo_core.io.npz",
    "OpenFoam": "agglo_core.io.openfoam.format",
    "Vtu": "agglo_core.io.vtk.vtu",
}


def __getattr__(name: str) -> object:
    """Return a file format class and import its module only when needed.

    The registry finds formats without this module.
    """
    if name not in _CLASSES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_CLASSES[name]), name)


@suggest_keywords()
def read(
    path: str | PathLike[str],
    *,
    merge_points: bool = True,
    allow_gaps: bool = False,
    drop_flat: bool = False,
    registry: Registry | None = None,
) -> Mesh:
    """Read the mesh in a file.

    The suffix selects the format.

    If several formats claim a suffix, the first to accept the file reads it: built-in formats come before
    plugins, and meshlane comes last.

    Integer cell data become cell tags. ``mesh.repairs`` counts everything left out or normalised (other cell
    data, orphan points, clockwise cells, lower-dimensional cells, higher-order nodes).

    Parameters
    ----------
    path : path
    merge_points : bool
        Merge exactly equal points. An ``.npz`` written by :func:`write` is never changed.
    allow_gaps : bool
        Keep coincident outer faces: a crack (with ``merge_points=False`` if its points are doubled) or
        touching bodies. By default they are joined as by :meth:`Mesh.conforming
        <agglo_core.mesh.Mesh.conforming>`; for an ``.npz`` written by :func:`write` they only cause a
        warning.
    drop_flat : bool
        Drop cells with zero area or volume, such as pinched layers, and renumber the others in order. By
        default such cells are an error. Formats stored face by face (OpenFOAM, MRST's ``G``, an ``.npz``
        written by :func:`write`) drop no cells.
    registry : Registry, optional
        Registry with the formats; by default the installed plugins.

    Raises
    ------
    FileError
        With the file name, if the file is missing, empty, truncated, corrupt or of unknown format, or is a
        folder in no known format.
    MeshError
        With file and cells, if the mesh breaks a rule.
    OptionError
        If ``path`` is not a path, or the format does not support an option.
    PluginError
        If a format returns no mesh or raises anything except an AggloError.

    Examples
    --------
    >>> import agglo_core as agglo
    >>> agglo.write("grid.vtu", agglo.samples.squares(4))
    >>> agglo.read("grid.vtu")
    Mesh('grid', 2-D, 16 cells, 40 faces, 25 points)
    """
    source = _check_source(path)
    options = {} if merge_points else {"merge_points": False}
    if allow_gaps:
        options["allow_gaps"] = True
    if drop_flat:
        options["drop_flat"] = True
    with name_in_errors(source):
        return _formats(registry, options).first_accepted(source, read_by)


@suggest_keywords()
def read_hierarchy(
    path: str | PathLike[str], *, allow_gaps: bool = False, registry: Registry | None = None
) -> tuple[Mesh, Hierarchy | None]:
    """Read the mesh in a file, and the hierarchy stored with it (None if there is none).

    An ``.npz`` holds the whole hierarchy. Most other formats store it as integer cell data ``level_0``,
    ``level_1``, …, without the targets.

    Parameters
    ----------
    path : path
    allow_gaps : bool
        As in :func:`read`.
    registry : Registry, optional
        Registry with the formats; by default the installed plugins.

    Raises
    ------
    FileError, MeshError, OptionError, PluginError
        As :func:`read`.

    Examples
    --------
    >>> mesh = agglo.samples.squares(8)
    >>> agglo.write("out.npz", mesh, agglo.agglomerate(mesh, n_parts=4))
    >>> mesh, hierarchy = agglo.read_hierarchy("out.npz")
    >>> hierarchy.parts
    [4]
    """
    source = _check_source(path)
    with name_in_errors(source):
        formats = _formats(registry, {"allow_gaps": True} if allow_gaps else {})
        return formats.first_accepted(source, read_hierarchy_by)


@suggest_keywords()
def write(
    path: str | PathLike[str],
    mesh: Mesh,
    hierarchy: Hierarchy | None = None,
    *,
    level_values: LevelValues | None = None,
    compress: bool = False,
    registry: Registry | None = None,
    progress: Listener | None = None,
    verbose: bool = False,
) -> None:
    """Write a mesh and optionally its hierarchy.

    The suffix selects the format.

    ``.npz`` keeps everything. ``.vtu`` holds the mesh with its tags and all level labels as cell data
    ``level_0``, …. Each coarse mesh goes into a file ``NAME_level0.vtu``, … beside it, with label, parent,
    cell count, measure and diameter per agglomerate. Other formats raise an error instead of losing
    data, and warn about face tags that they cannot hold.

    Files appear whole or not at all. Remains from an earlier hierarchy are removed: mesh tags
    ``level_<number>`` are not written to such files, and superfluous coarse meshes are deleted (only files
    named ``NAME_level<number>.vtu`` beside the new file and written by agglo).

    Parameters
    ----------
    path : path
    mesh : Mesh
    hierarchy : Hierarchy, optional
    level_values : sequence of mappings of name to (k,) float, optional
        More cell data for the coarse meshes, one mapping per level with values on its k agglomerates, such
        as ``[level.values for level in measure_levels(mesh, hierarchy)]``. Stored in ``.vtu`` and in formats
        that declare ``keeps_level_values``; others hold no coarse meshes.
    compress : bool
        Write smaller ``.vtu`` and ``.npz`` files; writing and reading take several times longer.
    registry : Registry, optional
        Registry with the formats; by default the installed plugins.
    progress, verbose : optional
        As for :func:`agglo_core.agglomerate`; files are whole or absent if ``progress`` raises.

    Raises
    ------
    FileError
        With the file name, if it cannot be written.
    MeshError
        If the hierarchy belongs to another mesh, or the file cannot hold a tag name.
    OptionError
        If an argument has a wrong type, the values do not fit the levels, or the format does not compress.
    PluginError
        If a format writes nothing or raises anything except an AggloError.

    Examples
    --------
    >>> mesh = agglo.samples.squares(4)
    >>> agglo.write("squares.vtu", mesh)
    >>> agglo.read("squares.vtu").n_cells
    16
    """
    target = _check_path("write", path)
    _check_written(mesh, hierarchy)
    with followed(progress, verbose) as followers, unwrapped(followers) as listen, name_in_errors(target):
        file_format = _writer(target, registry, {"compress": True} if compress else {})
        if hierarchy is not None:
            from agglo_core.io.levels import check_belongs

            check_belongs(mesh, hierarchy)
        if level_values is not None:
            from agglo_core.io.levels import check_level_values

            check_level_values(hierarchy, level_values)
        with phase(labelled(listen, target.name), "writing") as notify:
            write_by(file_format, target, mesh, hierarchy, notify, level_values)


def check_writable(
    path: str | PathLike[str], *, compress: bool = False, registry: Registry | None = None
) -> None:
    """Raise FileError if writing to this path would certainly fail.

    A format must write this suffix, the folder must exist, and the path must not be a folder. OptionError is
    raised for ``compress`` and a format that does not compress.

    Examples
    --------
    >>> from agglo_core.io import check_writable
    >>> check_writable("out.vtu")  # all is well
    >>> check_writable("nowhere/out.vtu")
    Traceback (most recent call last):
        ...
    agglo_core.errors.FileError: nowhere/out.vtu: the folder nowhere does not exist
    """
    target = _check_path("write", path)
    with name_in_errors(target):
        _writer(target, registry, {"compress": True} if compress else {})


def _formats(registry: Registry | None, options: dict[str, bool]) -> Formats:
    return Formats(default() if registry is None else registry, options)


def _writer(target: Path, registry: Registry | None, options: dict[str, bool]) -> KnownFormat:
    """Return the format that writes the file, after a check that the file can be created or replaced."""
    if target.is_dir():
        raise FileError(
            f"is a folder, expected a file name such as {target / 'out.vtu'} (for an OpenFOAM case "
            f"{target / 'out.foam'})"
        )
    file_format = _formats(registry, options).writer(target)
    if not target.parent.is_dir():
        raise FileError(f"the folder {target.parent} does not exist")
    from agglo_core.io.atomic import check_replaceable

    check_replaceable(target)
    return file_format


def _check_source(path: object) -> Path:
    """Return the argument of ``read`` as a path if it leads to a regular file or a folder.

    Raises FileError or OptionError otherwise.
    """
    source = _check_path("read", path)
    with name_in_errors(source):
        if not source.is_dir():  # some formats read folders
            check_regular(source)
    return source


def _check_path(function: str, path: object) -> Path:
    """Return the argument as a path if the operating system can represent the file name.

    Raises FileError or OptionError otherwise.
    """
    if not isinstance(path, str | PathLike):
        call = "read(path)" if function == "read" else "write(path, mesh, hierarchy)"
        raise OptionError(f"{call}: the path must be a str or a Path, given {type(path).__name__}")
    try:
        os.fsencode(path)
    except UnicodeEncodeError:
        encoding = sys.getfilesystemencoding()
        raise FileError(
            f"{str(path)!a}: the name has characters outside {encoding}, the encoding of file names"
        ) from None
    if "\0" in str(path):
        raise FileError(f"{str(path)!a}: a file name cannot hold a null character")
    return Path(path)


def _check_written(mesh: object, hierarchy: object) -> None:
    """Raise OptionError unless ``write`` received a Mesh, and a Hierarchy or None."""
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.mesh import Mesh

    call = "write(path, mesh, hierarchy)"
    if isinstance(mesh, Hierarchy):
        raise OptionError(f"{call}: the mesh comes before the hierarchy, as in write(path, h.fine, h)")
    if not isinstance(mesh, Mesh):
        raise OptionError(f"{call}: the mesh must be a Mesh, given {type(mesh).__name__}")
    if hierarchy is not None and not isinstance(hierarchy, Hierarchy):
        type_name = type(hierarchy).__name__
        raise OptionError(f"{call}: the hierarchy must be a Hierarchy, given {type_name}")
