"""Formats that hold points and cells, written with each coarse mesh in a file beside."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from agglo_core.io.format_options import Reading

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.mesh import Mesh


class Fvca(Reading):
    """Plane meshes of the FVCA benchmarks, as HArDCore2D and DISK++ read them; written as ``.typ2``."""

    lossless: bool = False

    def recognises(self, head: bytes) -> bool:
        """Whether a file begins as these do: with the title of the points."""
        return head.lstrip()[:8].lower() == b"vertices"

    def read(self, path: Path) -> Mesh:
        """Return the mesh of a file; raises FileError or MeshError."""
        from agglo_core.io.text.fvca import read_fvca

        return read_fvca(path, **self.reading)

    def write(self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        """Write a plane mesh, its tags and labels, and each coarse mesh beside it; raises an AggloError."""
        from agglo_core.io.text.fvca import write_typ2

        write_typ2(path, mesh, hierarchy)


class RegnFace(Reading):
    """Polyhedra as lists of faces in ``NAME.ele``, points in ``NAME.node``: either name stands for both.

    Triangle's triangles and TetGen's tetrahedra in files of these suffixes are read, too.
    """

    lossless: bool = False

    def read(self, path: Path) -> Mesh:
        """Return the mesh of both files; raises FileError or MeshError."""
        from agglo_core.io.text.rf import read_rf

        return read_rf(path, **self.reading)

    def write(self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        """Write both files, each coarse mesh and the cells of its parts beside; raises an AggloError."""
        from agglo_core.io.text.rf import write_rf

        write_rf(path, mesh, hierarchy)


class Hedra(Reading):
    """Points, faces, and polyhedra as lists of faces, negative where a face is seen from inside."""

    lossless: bool = False

    def read(self, path: Path) -> Mesh:
        """Return the mesh of a file; raises FileError or MeshError."""
        from agglo_core.io.text.hedra import read_hedra

        return read_hedra(path, **self.reading)

    def write(self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        """Write a solid mesh, its tags and labels, and each coarse mesh beside it; raises an AggloError."""
        from agglo_core.io.text.hedra import write_hedra

        write_hedra(path, mesh, hierarchy)


class Ovm(Reading):
    """OpenVolumeMesh as text: points, edges, faces of half-edges, and polyhedra of half-faces."""

    lossless: bool = False

    def recognises(self, head: bytes) -> bool:
        """Whether a file begins as these do."""
        return head.split(maxsplit=2)[:2] == [b"OVM", b"ASCII"]

    def read(self, path: Path) -> Mesh:
        """Return the mesh of a file; raises FileError or MeshError."""
        from agglo_core.io.text.ovm import read_ovm

        return read_ovm(path, **self.reading)

    def write(self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        """Write a solid mesh, its tags and labels, and each coarse mesh beside it; raises an AggloError."""
        from agglo_core.io.text.ovm import write_ovm

        write_ovm(path, mesh, hierarchy)


class Off(Reading):
    """OFF: points and polygons; a constant z makes a plane mesh, surfaces are refused."""

    lossless: bool = False

    def recognises(self, head: bytes) -> bool:
        """Whether a file begins as these do."""
        return re.match(rb"\s*(?:ST)?C?N?OFF\s", head) is not None

    def read(self, path: Path) -> Mesh:
        """Return the mesh of a file; raises FileError or MeshError."""
        from agglo_core.io.text.polygon_files import read_off

        return read_off(path, **self.reading)

    def write(self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        """Write a plane mesh, its tags and labels, and each coarse mesh beside it; raises an AggloError."""
        from agglo_core.io.text.polygon_files import write_off

        write_off(path, mesh, hierarchy)


class Obj(Reading):
    """Wavefront OBJ: points and polygons; a constant z makes a plane mesh, surfaces are refused."""

    lossless: bool = False

    def read(self, path: Path) -> Mesh:
        """Return the mesh of a file; raises FileError or MeshError."""
        from agglo_core.io.text.polygon_files import read_obj

        return read_obj(path, **self.reading)

    def write(self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        """Write a plane mesh, its tags and labels, and each coarse mesh beside it; raises an AggloError."""
        from agglo_core.io.text.polygon_files import write_obj

        write_obj(path, mesh, hierarchy)


class Ply(Reading):
    """PLY: points and polygons with whole numbers for each, as text or binary; surfaces are refused."""

    lossless: bool = False

    def recognises(self, head: bytes) -> bool:
        """Whether a file begins as these do."""
        return head.startswith((b"ply\n", b"ply\r\n"))

    def read(self, path: Path) -> Mesh:
        """Return the mesh of a file; raises FileError or MeshError."""
        from agglo_core.io.text.ply import read_ply

        return read_ply(path, **self.reading)

    def write(self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        """Write a plane mesh, its tags and labels, and each coarse mesh beside it; raises an AggloError."""
        from agglo_core.io.text.ply import write_ply

        write_ply(path, mesh, hierarchy)


class Pvtu(Reading):
    """The pieces of a parallel unstructured grid as one mesh, without ghost cells.

    Without merged points, pieces stay apart where they meet.
    """

    lossless: bool = False

    def recognises(self, head: bytes) -> bool:
        """Whether a file begins as these do."""
        return b"<VTKFile" in head and b"PUnstructuredGrid" in head

    def read(self, path: Path) -> Mesh:
        """Return the mesh of all pieces; raises FileError or MeshError."""
        from agglo_core.io.vtk.pvtu import read_pvtu

        return read_pvtu(path, **self.reading)


class Vtp(Reading):
    """Polygons and strips of VTK XML PolyData; a constant z makes a plane mesh, surfaces are refused."""

    lossless: bool = False

    def recognises(self, head: bytes) -> bool:
        """Whether a file begins as these do."""
        return b"<VTKFile" in head and b'"PolyData"' in head

    def read(self, path: Path) -> Mesh:
        """Return the mesh of a file; raises FileError or MeshError."""
        from agglo_core.io.vtk.vtu_read import read_vtp

        return read_vtp(path, **self.reading)
