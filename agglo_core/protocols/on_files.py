"""Protocols of file formats: reading, writing, and storage of hierarchies."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.mesh import Mesh


@runtime_checkable
class Format(Protocol):
    """Component that reads meshes from files of one format.

    Its suffixes are declared (:class:`~agglo_core.registry.Component`), or are the attribute ``suffixes``.
    ``lossless`` is True if written data are read back to the last bit, hierarchy included. A format rejects a
    file with an AggloError, and the next format with this suffix is tried. OSErrors are reported unchanged;
    other exceptions are bugs in the format.

    The following attributes are optional and false by default. ``last_resort``: the format is tried after all
    others. ``reads_empty``: empty files are valid. ``atomic``: its own ``write`` is atomic.
    ``keeps_level_values``: its ``write`` takes a fourth argument with numbers ``(k,)`` by name for each
    level. ``recognises(head)``, for formats without declared suffixes, may recognise other files by their
    first 512 bytes, and ``recognises_folder(folder)`` a folder as a whole. The constructor options
    ``merge_points``, ``allow_gaps`` and ``drop_flat`` (bool) are those of ``agglo.read``.

    Examples
    --------
    >>> from pathlib import Path
    >>> from agglo_core.protocols import Format
    >>> class Squares:
    ...     lossless = False
    ...
    ...     def read(self, path):
    ...         return agglo.samples.squares(int(path.read_text()))
    >>> _ = Path("mesh.n").write_text("2")
    >>> isinstance(Squares(), Format), Squares().read(Path("mesh.n")).n_cells
    (True, 4)
    """

    lossless: bool

    def read(self, path: Path) -> Mesh:
        """Read the mesh from an existing file, or raise an AggloError with the reason."""


@runtime_checkable
class WritableFormat(Protocol):
    """Optional protocol: a format that also writes files.

    All files that ``write`` leaves beside ``path`` are moved to the user's location together with it. With
    ``reports_progress = True`` it takes the keyword ``notify``, and calls ``notify(fraction, text)`` as it
    proceeds.

    Examples
    --------
    >>> from pathlib import Path
    >>> from agglo_core.protocols import WritableFormat
    >>> class Outlines:
    ...     def write(self, path, mesh, hierarchy=None):
    ...         path.write_text(f"{mesh.points.tolist()}")
    >>> isinstance(Outlines(), WritableFormat)
    True
    >>> Outlines().write(Path("mesh.txt"), agglo.samples.squares(1))
    >>> Path("mesh.txt").read_text()
    '[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]'
    """

    def write(self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        """Write the mesh, and the hierarchy if given, or raise an AggloError for unsupported data."""


@runtime_checkable
class HierarchyFormat(Protocol):
    """Optional protocol: a format that stores complete hierarchies, with targets and statistics.

    Examples
    --------
    >>> from pathlib import Path
    >>> from agglo_core.protocols import HierarchyFormat
    >>> class Squares:
    ...     def read_hierarchy(self, path):
    ...         return agglo.samples.squares(int(path.stem)), None  # it has no levels
    >>> isinstance(Squares(), HierarchyFormat), Squares().read_hierarchy(Path("2.n"))[0].n_cells
    (True, 4)
    """

    def read_hierarchy(self, path: Path) -> tuple[Mesh, Hierarchy | None]:
        """Read the mesh and the stored hierarchy, if any, from an existing file."""
