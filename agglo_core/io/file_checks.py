"""Call file format methods, and check their arguments and results.

Every error names the file and the format at fault.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agglo_core.errors import AggloError, FileError, MeshError, OptionError, PluginError
from agglo_core.io.atomic import staging
from agglo_core.io.formats import KnownFormat
from agglo_core.progress import Notify
from agglo_core.registry.attribution import attributed
from agglo_core.registry.containment import describe_error, shown

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.io.levels import LevelValues
    from agglo_core.mesh import Mesh

_ON_PURPOSE = (AggloError, OSError, MemoryError)


def read_by(known: KnownFormat, path: Path) -> Mesh:
    """Read a mesh with the given format.

    Raises
    ------
    AggloError
        If the format rejects the file.
    PluginError
        If it raises anything else or returns no mesh.
    """
    _check_content(known, path)
    with attributed(known.title, spare=_ON_PURPOSE):
        mesh = known.tool.read(path)
    return _check_mesh(known, "read", mesh)


def read_hierarchy_by(known: KnownFormat, path: Path) -> tuple[Mesh, Hierarchy | None]:
    """Read a mesh and its hierarchy, from tags ``level_0``, … if the format stores no hierarchies.

    Raises as :func:`read_by`.
    """
    mesh, hierarchy = (
        _read_with_hierarchy(known, path) if known.has("read_hierarchy") else (read_by(known, path), None)
    )
    if hierarchy is not None:
        return mesh, hierarchy
    from agglo_core.io.levels import split_levels

    return split_levels(mesh)


def write_by(
    known: KnownFormat,
    path: Path,
    mesh: Mesh,
    hierarchy: Hierarchy | None,
    notify: Notify,
    level_values: LevelValues | None = None,
) -> None:
    """Write a mesh with the given format, so that the file appears whole or not at all.

    Pass the optional arguments that the format declares.

    Raises
    ------
    AggloError
        If the format rejects the mesh.
    PluginError
        If it raises anything else or writes nothing.
    """
    values = (level_values,) if level_values is not None and known.has("keeps_level_values") else ()
    options = {"notify": notify} if known.has("reports_progress") else {}
    if known.has("atomic"):
        with attributed(known.title, spare=_ON_PURPOSE):
            known.tool.write(path, mesh, hierarchy, *values, **options)
        return
    with staging(path) as folder:
        target = folder / path.name
        with attributed(known.title, spare=_ON_PURPOSE):
            known.tool.write(target, mesh, hierarchy, *values, **options)
        if not target.is_file():
            raise PluginError(f"{known.title}: write() did not create the file it was given")


@contextmanager
def name_in_errors(path: Path) -> Iterator[None]:
    """Prefix the file name to the message of any error raised in the ``with`` block."""
    try:
        yield
    except OptionError:
        raise
    except AggloError as error:
        family = next((kind for kind in (MeshError, PluginError) if isinstance(error, kind)), FileError)
        text = str(error)
        raise family(text if text.startswith(f"{path}: ") else f"{path}: {text}") from error.__cause__
    except (OSError, MemoryError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else repr(error)
        raise FileError(f"{path}: {reason}") from error


def _check_content(file_format: KnownFormat, path: Path) -> None:
    if path.stat().st_size == 0 and not file_format.has("reads_empty"):
        raise FileError("is empty")


def _read_with_hierarchy(file_format: KnownFormat, path: Path) -> tuple[Mesh, Hierarchy | None]:
    """Read mesh and hierarchy with a format that can store both."""
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.io.levels import check_belongs

    _check_content(file_format, path)
    with attributed(file_format.title, spare=_ON_PURPOSE):
        pair = file_format.tool.read_hierarchy(path)
    if not isinstance(pair, tuple) or len(pair) != 2:
        raise PluginError(
            f"{file_format.title}: read_hierarchy() returned {shown(pair)}, expected (mesh, hierarchy)"
        )
    # Check the types, then that the hierarchy belongs to the mesh.
    mesh, hierarchy = _check_mesh(file_format, "read_hierarchy", pair[0]), pair[1]
    if hierarchy is None:
        return mesh, None
    if not isinstance(hierarchy, Hierarchy):
        raise PluginError(
            f"{file_format.title}: read_hierarchy() returned the hierarchy {shown(hierarchy)}, "
            "expected a Hierarchy or None"
        )
    try:
        check_belongs(mesh, hierarchy)
    except AggloError as error:
        raise PluginError(
            f"{file_format.title}: read_hierarchy() returned a hierarchy of another mesh: "
            f"{describe_error(error)}"
        ) from error
    return mesh, hierarchy


def _check_mesh(file_format: KnownFormat, method: str, mesh: Any) -> Mesh:
    from agglo_core.mesh import Mesh

    if not isinstance(mesh, Mesh):
        raise PluginError(f"{file_format.title}: {method}() returned {shown(mesh)}, expected a Mesh")
    name = _replace_surrogates(mesh.name)
    return mesh if name == mesh.name else replace(mesh, name=name)


def _replace_surrogates(name: str) -> str:
    """Return the name in printable form, even if its bytes do not fit the locale's encoding."""
    try:
        return name.encode(errors="surrogateescape").decode(errors="replace")
    except UnicodeEncodeError:  # other surrogates
        return name.encode(errors="replace").decode()
