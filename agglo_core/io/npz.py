"""Read and write agglo's own file format, a lossless ``.npz`` archive without pickle.

It contains all arrays of a mesh and its hierarchy.

``meta`` holds JSON: format, version, names, repairs, and the targets, nesting and statistics of the
hierarchy. The plain layout ``points, cell_offsets, cell_vertices`` (polygons) is also supported for reading.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from agglo_core.arrays import frozen_float, narrow, trusted
from agglo_core.errors import FileError, MeshError, OptionError
from agglo_core.files.archive import Archive
from agglo_core.io.atomic import staging
from agglo_core.io.to_mesh.options import Compressing
from agglo_core.mesh import Mesh
from agglo_core.mesh.construction.conforming import warn_of_gaps
from agglo_core.progress import Notify, ignore_progress, part

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy

_FORMAT, _VERSION = "agglo", 2
_PLAIN = ("points", "cell_offsets", "cell_vertices")
_MESH = ("points", "face_offsets", "face_vertices", "face_cells")
_META = 1 << 24  # bytes of JSON, enough for thousands of levels
_LEVEL = 1  # deflate level: higher levels take twice the time and save a few per cent


class Npz(Compressing):
    """Files ``.npz`` without pickle: a mesh with its hierarchy, or just points and polygons.

    Parameters
    ----------
    merge_points : bool
        Merge exactly equal points of the plain layout; a file written by agglo is never changed.
    allow_gaps : bool
        Keep coincident outer faces.
    compress : bool
        Deflate the arrays: smaller files, slower to write and to read.
    drop_flat : bool
        Drop cells with zero area or volume.

    Examples
    --------
    >>> from pathlib import Path
    >>> from agglo_core.io import Npz
    >>> Npz(compress=True).write(Path("mesh.npz"), agglo.samples.squares(2))
    >>> Npz().read(Path("mesh.npz")).n_cells
    4
    """

    lossless: bool = True
    atomic: bool = True
    reports_progress: bool = True

    def read(self, path: Path) -> Mesh:
        """Read the mesh in an ``.npz`` file.

        Raises FileError or MeshError.
        """
        return self.read_hierarchy(path)[0]

    def read_hierarchy(self, path: Path) -> tuple[Mesh, Hierarchy | None]:
        """Read mesh and hierarchy from an ``.npz`` file written by agglo, or a mesh from plain arrays.

        Raises
        ------
        FileError
            With the name of the missing or corrupt array.
        MeshError
            For a plain file with invalid polygons.
        """
        arrays = Archive(path)
        if "meta" in arrays.members:
            return _native(arrays, self.allow_gaps)
        if not set(_PLAIN) <= arrays.members.keys():
            raise FileError(
                f"holds neither an agglo mesh (array 'meta') nor the arrays {', '.join(_PLAIN)}; "
                f"found {', '.join(list(arrays.members)[:20]) or 'no arrays'}. Polygon c has the points "
                "cell_vertices[cell_offsets[c]:cell_offsets[c + 1]]; Mesh.from_polygons takes lists of points"
            )
        offsets = arrays.integers("cell_offsets", (None,))
        vertices = arrays.integers("cell_vertices", (int(offsets[-1]) if offsets.size else None,))
        points = arrays.take("points", "fiu", (None, None))
        cells = (offsets, vertices)
        mesh = Mesh.from_polygons(points, cells, **self.reading, name=path.stem)
        return mesh, None

    def write(
        self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None, notify: Notify = ignore_progress
    ) -> None:
        """Write mesh and hierarchy without loss.

        Report each array to ``notify``.
        """
        arrays: dict[str, NDArray[Any]] = {name: getattr(mesh, name) for name in _MESH}
        # Collect the arrays and the metadata.
        meta: dict[str, Any] = {
            "format": _FORMAT,
            "version": _VERSION,
            "name": mesh.name,
            "fingerprint": mesh.fingerprint,
            "repairs": dict(mesh.repairs),
            "cell_tags": list(mesh.cell_tags),
            "face_tags": list(mesh.face_tags),
        }
        arrays |= {f"cell_tag_{i}": values for i, values in enumerate(mesh.cell_tags.values())}
        arrays |= {f"face_tag_{i}": values for i, values in enumerate(mesh.face_tags.values())}
        if hierarchy is not None:
            arrays |= {f"level_{i}": labels for i, labels in enumerate(hierarchy.levels)}
            meta["hierarchy"] = {
                "targets": list(hierarchy.targets),
                "nested": hierarchy.nested,
                "statistics": hierarchy.statistics,
            }
        text = json.dumps(meta, default=_plain).encode()
        if len(text) > _META:
            raise FileError(
                f"names, targets and statistics take {len(text)} bytes as JSON, expected at most {_META}"
            )
        # Write the arrays one by one to report progress.
        arrays = {"meta": np.frombuffer(text, np.uint8), **arrays}
        method = zipfile.ZIP_DEFLATED if self.compress else zipfile.ZIP_STORED
        with (
            staging(path) as folder,
            zipfile.ZipFile(folder / path.name, "w", method, compresslevel=_LEVEL) as archive,
        ):
            for place, (name, values) in enumerate(arrays.items()):  # as np.savez does
                part(notify, place, len(arrays), name)
                with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
                    npy.write_array(entry, narrow(values), allow_pickle=False)


def _plain(value: Any) -> Any:
    """Convert arrays, dataclasses and containers to types that JSON can store."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, tuple | set | frozenset):
        return list(value)
    raise FileError(f"statistics or targets hold a {type(value).__name__}, expected plain data")


def _native(arrays: Archive, allow_gaps: bool) -> tuple[Mesh, Hierarchy | None]:
    meta = _meta(arrays)
    cells = arrays.integers("face_cells", (None, 2))
    offsets = arrays.integers("face_offsets", (len(cells) + 1,))
    vertices = arrays.integers("face_vertices", (int(offsets[-1]),))
    # Any inconsistency in the arrays or the metadata means that the file is corrupt.
    try:
        mesh = trusted(
            Mesh,
            points=frozen_float(arrays.take("points", "f", (None, None))),
            face_offsets=offsets,
            face_vertices=vertices,
            face_cells=cells,
            cell_tags=_tags(arrays, meta, "cell", int(cells.max(initial=-1)) + 1),
            face_tags=_tags(arrays, meta, "face", len(cells)),
            repairs={str(text): int(count) for text, count in meta["repairs"].items()},
            name=str(meta["name"]),
        )
        if mesh.fingerprint != meta["fingerprint"]:
            raise FileError("the mesh arrays do not match their fingerprint: the file was altered")
        mesh.check()
        if not allow_gaps:
            warn_of_gaps(mesh)
        return mesh, _hierarchy(arrays, meta, mesh)
    except FileError:
        raise
    except (MeshError, OptionError) as error:
        raise FileError(f"is corrupt: {error}") from None
    except (KeyError, TypeError, AttributeError, IndexError, ValueError, OverflowError) as error:
        raise FileError(f"is corrupt: {type(error).__name__} {error}") from None


def _meta(arrays: Archive) -> dict[str, Any]:
    try:
        meta = json.loads(arrays.take("meta", "u", (None,), _META).tobytes())
    except FileError:
        raise
    except (ValueError, RecursionError) as error:
        raise FileError(f"array 'meta' is corrupt: {error}") from None
    if not isinstance(meta, dict) or meta.get("format") != _FORMAT:
        raise FileError("array 'meta' does not describe an agglo mesh")
    if meta.get("version") != _VERSION:
        raise FileError(f"format version {meta.get('version')} is unknown, expected {_VERSION}")
    return meta


def _tags(arrays: Archive, meta: dict[str, Any], kind: str, count: int) -> dict[str, NDArray[Any]]:
    names = enumerate(meta[f"{kind}_tags"])
    return {str(name): arrays.integers(f"{kind}_tag_{i}", (count,)) for i, name in names}


def _hierarchy(arrays: Archive, meta: dict[str, Any], mesh: Mesh) -> Hierarchy | None:
    from agglo_core.hierarchy import Hierarchy

    stored = meta.get("hierarchy")
    if stored is None:
        return None
    targets = stored["targets"]
    levels = [arrays.integers(f"level_{i}", (mesh.n_cells,)) for i in range(len(targets))]
    return Hierarchy(mesh, mesh.graph, levels, targets, bool(stored["nested"]), stored["statistics"])
