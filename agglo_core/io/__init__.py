"""Reading and writing files; the suffix chooses the format, one of agglo's own or of a plugin.

:func:`read` gives the mesh of a file, :func:`read_hierarchy` also the hierarchy stored with it, and
:func:`write` writes both; :mod:`agglo_core` offers all three. Formats are components like any other (kind
``format``, :class:`~agglo_core.protocols.Format`); agglo's own are :class:`Vtu`, :class:`Npz`,
:class:`Meshlane` and :class:`OpenFoam`.
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
from agglo_core.io.file_checks import naming, read_by, read_hierarchy_by, write_by
from agglo_core.io.formats import Formats, KnownFormat
from agglo_core.progress import Listener, followed, labelled, phase, unwrapped
from agglo_core.registry import Registry, default

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
    """Import the class of a format on first use: the registry finds formats without this module."""
    if name not in _CLASSES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_CLASSES[name]), name)


def read(
    path: str | PathLike[str],
    *,
    merge_points: bool = True,
    allow_gaps: bool = False,
    drop_flat: bool = False,
    registry: Registry | None = None,
) -> Mesh:
    """Mesh of a file; its suffix chooses the format.

    Several formats may claim a suffix. The first that accepts the file reads it: agglo's own are asked
    before those of plugins, and what goes through meshlane is asked last.

    Integer cell data become cell tags. What was left out or normalised (other cell data, orphan
    points, clockwise cells, lower-dimensional cells, higher-order nodes) is counted in
    ``mesh.repairs``.

    Parameters
    ----------
    path : path
    merge_points : bool
        Merge exactly equal points. An ``.npz`` written by :func:`write` is never changed.
    allow_gaps : bool
        Leave outer faces that lie on one another as they are: a crack (with ``merge_points=False`` if
        it has two points at each place), bodies that touch. By default they are joined as by
        :meth:`Mesh.conforming <agglo_core.mesh.Mesh.conforming>`; an ``.npz`` written by :func:`write`
        is warned about.
    drop_flat : bool
        Leave out cells of zero area or volume, such as pinched layers; the others are numbered anew, in
        their order. By default such cells are an error. Formats that are read face by face (OpenFOAM, MRST's
        ``G``, an ``.npz`` written by :func:`write`) leave out none.
    registry : Registry, optional
        Where the formats are looked up; by default the installed plugins.

    Raises
    ------
    FileError
        Naming the file: missing, empty, truncated, corrupt, of an unknown format, or a folder that no
        format reads.
    MeshError
        For a mesh that breaks a rule, naming file and cells.
    OptionError
        If ``path`` is not a path, or the format does not know an option given here.
    PluginError
        If a format misbehaves: it returns something other than a mesh, or raises something other
        than an AggloError.

    Examples
    --------
    >>> import agglo_core as agglo
    >>> agglo.write("grid.vtu", agglo.samples.squares(4))
    >>> agglo.read("grid.vtu")
    Mesh('grid', 2-D, 16 cells, 40 faces, 25 points)
    """
    source = _existing(path)
    options = {} if merge_points else {"merge_points": False}
    if allow_gaps:
        options["allow_gaps"] = True
    if drop_flat:
        options["drop_flat"] = True
    with naming(source):
        return _formats(registry, options).first_accepted(source, read_by)


def read_hierarchy(
    path: str | PathLike[str], *, allow_gaps: bool = False, registry: Registry | None = None
) -> tuple[Mesh, Hierarchy | None]:
    """Mesh of a file and the hierarchy stored with it, if any.

    An ``.npz`` holds the whole hierarchy; in most other formats it is found in the integer cell data
    ``level_0``, ``level_1``, … (their targets are not stored there).

    Parameters
    ----------
    path : path
    allow_gaps : bool
        As in :func:`read`.
    registry : Registry, optional
        Where the formats are looked up; by default the installed plugins.

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
    source = _existing(path)
    with naming(source):
        formats = _formats(registry, {"allow_gaps": True} if allow_gaps else {})
        return formats.first_accepted(source, read_hierarchy_by)


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
    """Write a mesh, and the hierarchy if given; the suffix chooses the format.

    ``.npz`` keeps everything. ``.vtu`` holds the mesh with its tags and the labels of every level as
    cell data ``level_0``, …, and beside it each coarse mesh as ``NAME_level0.vtu``, …, with label, parent,
    number of cells, measure and diameter of each agglomerate. Other formats are refused where they would
    lose something. Files appear whole or not at all. What an earlier hierarchy left is replaced as a
    whole: tags ``level_<number>`` of the mesh are not written to such
    files, and coarse meshes of more levels than there are now are removed (only files named
    ``NAME_level<number>.vtu`` beside the new one that this program wrote).

    Parameters
    ----------
    path : path
    mesh : Mesh
    hierarchy : Hierarchy, optional
    level_values : sequence of mappings of name to (k,) float, optional
        More cell data for the coarse meshes, one mapping for each level: what was measured on its k
        agglomerates, such as ``[level.values for level in measure_levels(mesh, hierarchy)]``. Kept by
        ``.vtu`` and by formats that say ``keeps_level_values``; others hold no coarse meshes.
    compress : bool
        Smaller ``.vtu`` and ``.npz`` files, which take several times longer to write and to read.
    registry : Registry, optional
        Where the formats are looked up; by default the installed plugins.
    progress, verbose : optional
        As for :func:`agglo_core.agglomerate`; files are whole or absent if ``progress`` raises.

    Raises
    ------
    FileError
        Naming the file, if it cannot be written.
    MeshError
        If the hierarchy belongs to another mesh, or a cell tag has a name that the file cannot hold.
    OptionError
        If an argument is not of its type, the values do not fit the levels, or the format does not compress.
    PluginError
        If a format misbehaves: it writes nothing, or raises something other than an AggloError.

    Examples
    --------
    >>> mesh = agglo.samples.squares(4)
    >>> agglo.write("squares.vtu", mesh)
    >>> agglo.read("squares.vtu").n_cells
    16
    """
    target = _checked_path("write", path)
    _check_written(mesh, hierarchy)
    with followed(progress, verbose) as followers, unwrapped(followers) as listen, naming(target):
        known = _writer(target, registry, {"compress": True} if compress else {})
        if hierarchy is not None:
            from agglo_core.io.levels import check_belongs

            check_belongs(mesh, hierarchy)
        if level_values is not None:
            from agglo_core.io.levels import check_level_values

            check_level_values(hierarchy, level_values)
        with phase(labelled(listen, target.name), "writing") as tell:
            write_by(known, target, mesh, hierarchy, tell, level_values)


def check_writable(path: str | PathLike[str], *, registry: Registry | None = None) -> None:
    """Raise FileError unless a file can be written there, as far as can be told in advance.

    Some format must write its suffix, its folder must exist, and it must not be a folder itself.

    Examples
    --------
    >>> from agglo_core.io import check_writable
    >>> check_writable("out.vtu")  # all is well
    >>> check_writable("nowhere/out.vtu")
    Traceback (most recent call last):
        ...
    agglo_core.errors.FileError: nowhere/out.vtu: the folder nowhere does not exist
    """
    target = _checked_path("write", path)
    with naming(target):
        _writer(target, registry, {})


def _formats(registry: Registry | None, options: dict[str, bool]) -> Formats:
    return Formats(default() if registry is None else registry, options)


def _writer(target: Path, registry: Registry | None, options: dict[str, bool]) -> KnownFormat:
    """The format that writes the file, which can be put in its place."""
    if target.is_dir():
        raise FileError("is a folder, expected a file name")
    known = _formats(registry, options).writer(target)
    if not target.parent.is_dir():
        raise FileError(f"the folder {target.parent} does not exist")
    from agglo_core.io.atomic import check_replaceable

    check_replaceable(target)
    return known


def _existing(path: object) -> Path:
    """Path of a regular file or a folder; FileError, or OptionError for what is no path."""
    source = _checked_path("read", path)
    with naming(source):
        if not source.is_dir():  # some formats read folders
            check_regular(source)
    return source


def _checked_path(function: str, path: object) -> Path:
    """Path of a file, once its name can be encoded; FileError or OptionError otherwise."""
    if not isinstance(path, str | PathLike):
        call = "read(path)" if function == "read" else "write(path, mesh, hierarchy)"
        raise OptionError(f"{call}: the path must be a str or a Path, given {type(path).__name__}")
    try:
        os.fsencode(path)
    except UnicodeEncodeError:
        encoding = sys.getfilesystemencoding()
        raise FileError(
            f"{str(path)!a}: file names are encoded as {encoding}, which has no such characters"
        ) from None
    if "\0" in str(path):
        raise FileError(f"{str(path)!a}: a file name cannot hold a null character")
    return Path(path)


def _check_written(mesh: object, hierarchy: object) -> None:
    """Raise OptionError unless the arguments of ``write`` are a Mesh and a Hierarchy or None."""
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.mesh import Mesh

    call = "write(path, mesh, hierarchy)"
    if isinstance(mesh, Hierarchy):
        raise OptionError(f"{call}: the mesh comes before the hierarchy, as in write(path, h.fine, h)")
    if not isinstance(mesh, Mesh):
        raise OptionError(f"{call}: the mesh must be a Mesh, given {type(mesh).__name__}")
    if hierarchy is not None and not isinstance(hierarchy, Hierarchy):
        given = type(hierarchy).__name__
        raise OptionError(f"{call}: the hierarchy must be a Hierarchy, given {given}")
