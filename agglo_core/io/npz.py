"""The native format: an ``.npz`` with every array of a mesh and its hierarchy; nothing is lost, no pickle.

``meta`` holds JSON: format, version, names, repairs, and of the hierarchy targets, nested,
statistics. The plain layout ``points, cell_offsets, cell_vertices`` (polygons) is read too.
"""

from __future__ import annotations

import json
import lzma
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from agglo_core.arrays import frozen_float, frozen_int
from agglo_core.errors import FileError
from agglo_core.io.array_checks import check_arrays
from agglo_core.io.atomic import staging
from agglo_core.mesh import Mesh
from agglo_core.progress import Tell, part

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy

__all__ = ["read_npz", "write_npz"]

_FORMAT, _VERSION = "agglo", 1
_PLAIN = ("points", "cell_offsets", "cell_vertices")
_MESH = ("points", "face_offsets", "face_vertices", "face_cells")
_EXPANSION = 1100  # deflate cannot exceed 1032


def write_npz(path: Path, mesh: Mesh, hierarchy: Hierarchy | None, tell: Tell) -> None:
    """Write mesh and hierarchy, losslessly, and ``tell`` after each array."""
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
    arrays = {"meta": np.frombuffer(text, np.uint8), **arrays}
    with (
        staging(path) as folder,
        zipfile.ZipFile(folder / path.name, "w", zipfile.ZIP_DEFLATED) as archive,
    ):
        for place, (name, values) in enumerate(arrays.items()):  # as np.savez_compressed does
            part(tell, place, len(arrays), name)
            with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
                npy.write_array(entry, values, allow_pickle=False)


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


def read_npz(path: Path, *, merge_points: bool) -> tuple[Mesh, Hierarchy | None]:
    """Mesh and hierarchy of an ``.npz``, native or plain.

    Raises
    ------
    FileError
        Naming the array that is missing or corrupt.
    MeshError
        For a plain file whose polygons break a rule.
    """
    arrays = _Arrays(path)
    if "meta" in arrays.sizes:
        return _native(arrays)
    if not set(_PLAIN) <= arrays.sizes.keys():
        raise FileError(
            f"holds neither an agglo mesh (array 'meta') nor the arrays {', '.join(_PLAIN)}; "
            f"found {', '.join(list(arrays.sizes)[:20]) or 'no arrays'}"
        )
    points = arrays.take("points", "fiu", 2)
    cells = (arrays.take("cell_offsets", "iu", 1), arrays.take("cell_vertices", "iu", 1))
    return Mesh.from_polygons(points, cells, merge_points=merge_points, name=path.stem), None


class _Arrays:
    """Arrays of a zip archive, each checked against what the archive really holds before it is made."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            with zipfile.ZipFile(path) as archive:
                infos = archive.infolist()
        except _CORRUPT as error:
            raise FileError(f"not an npz archive, or truncated: {error}") from None
        self.sizes = {info.filename.removesuffix(".npy"): info for info in infos}

    def take(self, name: str, kinds: str, dims: int) -> NDArray[Any]:
        """The array, whose dtype is of one of ``kinds`` and which has ``dims`` dimensions."""
        if name not in self.sizes:
            raise FileError(f"array {name!r} is missing; found {', '.join(list(self.sizes)[:20])}")
        try:
            array = self._parse(self._content(name))
        except _CORRUPT as error:
            raise FileError(f"array {name!r} is corrupt: {error}") from None
        if array.dtype.kind not in kinds or array.ndim != dims:
            raise FileError(
                f"array {name!r} has dtype {array.dtype} and shape {array.shape}, "
                f"expected kind {' or '.join(kinds)} and {dims} dimensions"
            )
        return array

    def _content(self, name: str) -> bytes:
        info = self.sizes[name]
        room = self._path.stat().st_size
        if info.compress_size > room or info.file_size > _EXPANSION * info.compress_size + 1024:
            raise ValueError(f"it claims {info.file_size} bytes in a file of {room}")
        with zipfile.ZipFile(self._path) as archive:
            return archive.read(info)

    @staticmethod
    def _parse(content: bytes) -> NDArray[Any]:
        stream = BytesIO(content)
        version = npy.read_magic(stream)
        header = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}.get(version)
        if header is None:
            raise ValueError(f"npy version {version} is not supported")
        shape, fortran, dtype = header(stream)
        if dtype.hasobject:
            raise ValueError("it holds Python objects")
        count, rest = 1, len(content) - stream.tell()
        for length in shape:
            count *= length
        if count * dtype.itemsize != rest:
            raise ValueError(f"its header says {count} × {dtype}, but {rest} bytes follow")
        array = np.frombuffer(content, dtype, count, stream.tell())
        array = array.reshape(shape, order="F" if fortran else "C")
        return array.astype(dtype.newbyteorder("="), copy=False)


_CORRUPT = (
    ValueError,
    TypeError,
    KeyError,
    SyntaxError,
    OverflowError,
    EOFError,
    RuntimeError,
    NotImplementedError,
    struct.error,
    tokenize.TokenError,
    lzma.LZMAError,
    zipfile.BadZipFile,
    zlib.error,
)


def _native(arrays: _Arrays) -> tuple[Mesh, Hierarchy | None]:
    meta = _meta(arrays)
    face_offsets, face_vertices = (arrays.take(name, "iu", 1) for name in _MESH[1:3])
    try:
        mesh = Mesh(
            points=frozen_float(arrays.take("points", "f", 2)),
            face_offsets=frozen_int(face_offsets),
            face_vertices=frozen_int(face_vertices),
            face_cells=frozen_int(arrays.take("face_cells", "iu", 2)),
            cell_tags=_tags(arrays, meta, "cell"),
            face_tags=_tags(arrays, meta, "face"),
            repairs={str(text): int(count) for text, count in meta["repairs"].items()},
            name=str(meta["name"]),
        )
        if mesh.fingerprint != meta["fingerprint"]:
            raise FileError("the mesh arrays do not match their fingerprint: the file was altered")
        check_arrays(mesh)
        return mesh, _hierarchy(arrays, meta, mesh)
    except FileError:
        raise
    except (KeyError, TypeError, AttributeError, IndexError, ValueError) as error:
        raise FileError(f"is corrupt: {type(error).__name__} {error}") from None


def _meta(arrays: _Arrays) -> dict[str, Any]:
    try:
        meta = json.loads(arrays.take("meta", "u", 1).tobytes())
    except FileError:
        raise
    except (ValueError, RecursionError) as error:
        raise FileError(f"array 'meta' is corrupt: {error}") from None
    if not isinstance(meta, dict) or meta.get("format") != _FORMAT:
        raise FileError("array 'meta' does not say that this is an agglo mesh")
    if meta.get("version") != _VERSION:
        raise FileError(f"format version {meta.get('version')} is unknown; this program reads {_VERSION}")
    return meta


def _tags(arrays: _Arrays, meta: dict[str, Any], kind: str) -> dict[str, NDArray[Any]]:
    names = meta[f"{kind}_tags"]
    return {str(name): frozen_int(arrays.take(f"{kind}_tag_{i}", "iu", 1)) for i, name in enumerate(names)}


def _hierarchy(arrays: _Arrays, meta: dict[str, Any], mesh: Mesh) -> Hierarchy | None:
    from agglo_core.hierarchy import Hierarchy

    stored = meta.get("hierarchy")
    if stored is None:
        return None
    targets = stored["targets"]
    levels = [mesh.check_labels(arrays.take(f"level_{i}", "iu", 1)) for i in range(len(targets))]
    return Hierarchy(mesh, mesh.graph, levels, targets, bool(stored["nested"]), stored["statistics"])
