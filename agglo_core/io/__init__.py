"""Files: ``.vtu`` by our own reader and writer, lossless ``.npz``, every other format through meshlane.

:func:`read` gives the mesh of a file, :func:`read_hierarchy` also the hierarchy stored with it, and
:func:`write` writes both; :mod:`agglo_core` offers all three.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from agglo_core.errors import FileError, MeshError, OptionError

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.mesh import Mesh

__all__ = ["check_writable", "read", "read_hierarchy", "write"]


def read(path: str | PathLike[str], *, merge_points: bool = True) -> Mesh:
    """Mesh of a file; its suffix says the format.

    Integer cell data become cell tags. What was left out or normalised (other cell data, orphan
    points, clockwise cells, lower-dimensional cells, higher-order nodes) is counted in
    ``mesh.repairs``.

    Parameters
    ----------
    path : path
    merge_points : bool
        Merge exactly equal points. An ``.npz`` written by :func:`write` is never changed.

    Raises
    ------
    FileError
        Naming the file: missing, a folder, empty, truncated, corrupt, of an unknown format.
    MeshError
        For a mesh that breaks a rule, naming file and cells.
    OptionError
        If ``path`` is no path.
    """
    return _read(path, merge_points)[0]


def read_hierarchy(path: str | PathLike[str]) -> tuple[Mesh, Hierarchy | None]:
    """Mesh of a file and the hierarchy stored with it, if any.

    An ``.npz`` holds the whole hierarchy; in other formats it is found in the integer cell data
    ``level_0``, ``level_1``, … (their targets are not stored there).

    Raises
    ------
    FileError, MeshError, OptionError
        As :func:`read`.
    """
    mesh, hierarchy = _read(path, True)
    if hierarchy is None:
        from agglo_core.io.level_tags import split_levels

        with _naming(Path(path)):
            return split_levels(mesh)
    return mesh, hierarchy


def write(path: str | PathLike[str], mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
    """Write a mesh, and the hierarchy if given; the suffix says the format.

    ``.npz`` keeps everything. ``.vtu`` holds the mesh with its tags and the labels of every level as
    cell data ``level_0``, …, and beside it each coarse mesh as ``NAME_level0.vtu``, …. Other formats
    are refused where they would lose something. Files appear whole or not at all. What an earlier
    hierarchy left is replaced as a whole: tags ``level_<number>`` of the mesh are not written to such
    files, and coarse meshes of more levels than there are now are removed (only files named
    ``NAME_level<number>.vtu`` beside the new one that this program wrote).

    Raises
    ------
    FileError
        Naming the file, if it cannot be written.
    MeshError
        If the hierarchy belongs to another mesh, or a cell tag has a name that the file cannot hold.
    OptionError
        If an argument is not of its type.
    """
    target = _checked_path("write", path)
    _check_written(mesh, hierarchy)
    check_writable(target)
    with _naming(target):
        if hierarchy is not None:
            from agglo_core.io.level_tags import check_belongs

            check_belongs(mesh, hierarchy)
        suffix = target.suffix.lower()
        if suffix == ".vtu":
            from agglo_core.io.vtu_write import write_vtu

            write_vtu(target, mesh, hierarchy)
        elif suffix == ".npz":
            from agglo_core.io.npz import write_npz

            write_npz(target, mesh, hierarchy)
        else:
            from agglo_core.io.meshlane_write import write_foreign

            write_foreign(target, mesh, hierarchy)


def check_writable(path: str | PathLike[str]) -> None:
    """Raise FileError unless a file can be written there: known suffix, existing folder, no folder itself."""
    target = _checked_path("write", path)
    with _naming(target):
        if target.is_dir():
            raise FileError("is a folder, expected a file name")
        _check_suffix(target, writing=True)
        if not target.parent.is_dir():
            raise FileError(f"the folder {target.parent} does not exist")
        from agglo_core.io.atomic import check_replaceable

        check_replaceable(target)


def _read(path: str | PathLike[str], merge_points: bool) -> tuple[Mesh, Hierarchy | None]:
    source = _checked_path("read", path)
    with _naming(source):
        if source.is_dir():
            raise FileError("is a folder, expected a file")
        if not source.exists():
            raise FileError("no such file")
        _check_suffix(source, writing=False)
        if not source.is_file():
            raise FileError("is not a regular file")
        if source.stat().st_size == 0 and source.suffix.lower() != ".foam":
            raise FileError("is empty")
        suffix = source.suffix.lower()
        if suffix == ".npz":
            from agglo_core.io.npz import read_npz

            return read_npz(source, merge_points=merge_points)
        if suffix == ".vtu":
            from agglo_core.io.vtu_read import read_vtu

            return read_vtu(source, merge_points=merge_points), None
        from agglo_core.io.meshlane_read import read_foreign

        return read_foreign(source, merge_points=merge_points), None


def _checked_path(function: str, path: object) -> Path:
    if not isinstance(path, str | PathLike):
        call = "read(path)" if function == "read" else "write(path, mesh, hierarchy)"
        raise OptionError(f"{call}: the path must be a text or a Path, given {type(path).__name__}")
    return Path(path)


def _check_written(mesh: object, hierarchy: object) -> None:
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


def _check_suffix(path: Path, *, writing: bool) -> None:
    if path.suffix.lower() in (".vtu", ".npz"):
        return
    from agglo_core.io.meshlane_read import suffixes

    known = [".vtu", ".npz", *suffixes(writing=writing)]
    if path.suffix.lower() not in known:
        given = f"unknown suffix {path.suffix!r}" if path.suffix else "no suffix"
        raise FileError(f"{given}; expected one of {' '.join(known)}")


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Put the file's name before the message of whatever goes wrong with it."""
    try:
        yield
    except FileError as error:
        raise FileError(_named(path, error)) from error.__cause__
    except MeshError as error:
        raise MeshError(_named(path, error)) from error.__cause__
    except (OSError, MemoryError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else repr(error)
        raise FileError(f"{path}: {reason}") from error


def _named(path: Path, error: Exception) -> str:
    text = str(error)
    return text if text.startswith(f"{path}: ") else f"{path}: {text}"
