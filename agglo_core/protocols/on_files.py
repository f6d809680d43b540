"""Protocols of file formats."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.mesh import Mesh


@runtime_checkable
class Format(Protocol):
    """Reads meshes from files of one format.

    Its suffixes are declared (:class:`~agglo_core.registry.Component`); a format that declares none has them
    as the attribute ``suffixes``. ``lossless`` says whether what is written is read back to the last bit,
    hierarchy included. It refuses a file by an AggloError, and the next format of its suffix is tried;
    OSErrors are reported as they are; anything else is a bug of the format.

    Four attributes are optional, false where they are missing. ``last_resort``: it is tried after all others.
    ``reads_empty``: files of no bytes mean something to it. ``atomic``: its own ``write`` makes files appear
    whole or not at all. ``keeps_level_values``: its ``write`` takes a fourth argument, for each level numbers
    ``(k,)`` by name. ``recognises(head)`` of a format that declares no suffixes may know a file of another
    suffix by its first 512 bytes, ``recognises_folder(folder)`` a folder that is read as a whole.
    Options ``merge_points``, ``allow_gaps`` and ``drop_flat`` (bool) of the constructor are those of
    ``agglo.read``.

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
        """Return the mesh of an existing file; an AggloError says why it is refused."""


@runtime_checkable
class WritableFormat(Protocol):
    """Optional: a format that is also written.

    Whatever files ``write`` leaves beside ``path`` move with it to where the user wants them. One that says
    ``tells_progress = True`` takes the keyword ``tell``, and calls ``tell(fraction, text)`` as it goes.

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
        """Write the mesh, and the hierarchy if given; an AggloError says what the format cannot hold."""


@runtime_checkable
class HierarchyFormat(Protocol):
    """Optional: a format that keeps hierarchies as they are, targets and statistics included.

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
        """Return the mesh of an existing file and the hierarchy stored with it, if any."""
