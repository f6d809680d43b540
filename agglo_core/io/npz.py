"""The native format: an ``.npz`` with every array of a mesh and its hierarchy; nothing is lost, no pickle.

``meta`` holds JSON: format, version, names, repairs, and of the hierarchy targets, nested,
statistics. The plain layout ``points, cell_offsets, cell_vertices`` (polygons) is read too.
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
from agglo_core.progress import Tell, part, to_nobody

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy

_FORMAT, _VERSION = "agglo", 2
_PLAIN = ("points", "cell_offsets", "cell_vertices")
_MESH = ("points", "face_offsets", "face_vertices", "face_cells")
_META = 1 << 24  # bytes of JSON: thousands of levels
_LEVEL = 1  # of deflate: higher ones take twice as long for a few per cent


class Npz(Compressing):
    """npz without pickle: everything a mesh and its hierarchy hold, or polygons in a plain layout.

    Parameters
    ----------
    merge_points : bool
        Merge exactly equal points of the plain layout; a file written by agglo is never changed.
    allow_gaps : bool
        Leave outer faces that lie on one another as they are.
    compress : bool
        Deflate the arrays: smaller files, slower to write and to read.
    drop_flat : bool
        Leave out cells of zero area or volume.

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
    tells_progress: bool = True

    def read(self, path: Path) -> Mesh:
        """Return the mesh of an archive; raises FileError or MeshError."""
        return self.read_hierarchy(path)[0]

    def read_hierarchy(self, path: Path) -> tuple[Mesh, Hierarchy | None]:
        """Return mesh and hierarchy of an ``.npz``, native or plain.

        Raises
        ------
        FileError
            Naming the array that is missing or corrupt.
        MeshError
            For a plain file whose polygons break a rule.
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
        self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None, tell: Tell = to_nobody
    ) -> None:
        """Write mesh and hierarchy, losslessly, deflated if asked; ``tell`` before each array."""
        arrays: dict[str, NDArray[Any]] = {name: getattr(mesh, name) for name in _MESH}
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
                f"names, targets and statistics take {len(text)} bytes as JSON, at most {_META} fit"
            )
        arrays = {"meta": np.frombuffer(text, np.uint8), **arrays}
        method = zipfile.ZIP_DEFLATED if self.compress else zipfile.ZIP_STORED
        with (
            staging(path) as folder,
            zipfile.ZipFile(folder / path.name, "w", method, compresslevel=_LEVEL) as archive,
        ):
            for place, (name, values) in enumerate(arrays.items()):  # as np.savez does
                part(tell, place, len(arrays), name)
                with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
                    npy.write_array(entry, narrow(values), allow_pickle=False)


def _plain(value: Any) -> Any:
    """Plain data for types that JSON does not know."""
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
        raise FileError("array 'meta' does not say that this is an agglo mesh")
    if meta.get("version") != _VERSION:
        raise FileError(f"format version {meta.get('version')} is unknown; this program reads {_VERSION}")
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
