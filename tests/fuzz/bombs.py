"""Small files that claim or contain far more data than their size suggests."""

from __future__ import annotations

import base64
import io
import json
import struct
import zipfile
import zlib
from collections.abc import Iterator
from functools import cache

import numpy as np
from core.io.test_io_vtu import SQUARE, Writer
from fuzz.matrix_corpus import matrix_files
from fuzz.several import packed

from agglo_core import samples, write

__all__ = ["bombs"]

_BLOCK, _BLOCKS = 1 << 25, 12  # zeros: 400 MB
_LAUGHS = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' for i in range(1, 10))


@cache
def bombs(suffix: str) -> list[bytes]:
    """Return the bombs of a suffix, possibly none."""
    makers = {
        ".vtu": _vtu,
        ".npz": _npz,
        ".system.npz": _system,
        ".mtx": _market,
        ".toml": _toml,
        ".problem.toml": _toml,
        ".safetensors": _safetensors,
        ".geojson": _geojson,
    }
    return list(makers[suffix]()) if suffix in makers else []


def _vtu() -> Iterator[bytes]:
    """Yield VTU files with an array of 400 MB zeros, many values, or growing XML entities."""
    block = zlib.compress(bytes(_BLOCK), 9)
    cells = [(9, [0, 1, 2, 3]), (7, [1, 4, 5, 2])]
    # Each array in turn as compressed zeros, with the true and with a false block size.
    for name in ("Points", "connectivity", "offsets", "types", "mat"):
        for size in (_BLOCK, 16):
            head = np.array([_BLOCKS, size, 0, *[len(block)] * _BLOCKS], "<u8").tobytes()
            w = Writer("binary", "zlib")
            text = w.file(w.piece(SQUARE, cells, data=w.array("mat", [7, -9], "i4"))).decode()
            before, after = text.split(f'Name="{name}"')
            start = after.index(">") + 1
            coded = (base64.b64encode(head) + base64.b64encode(block * _BLOCKS)).decode()
            rest = after[after.index("</DataArray>") :]
            yield f'{before}Name="{name}"{after[:start]}{coded}{rest}'.encode()
    # Many ASCII values, then nested entities (billion laughs).
    w = Writer()
    text = w.file(w.piece(SQUARE, cells)).decode()
    yield text.replace("0.0 0.0", "0.0 0.0 " + "1 " * 2_000_000, 1).encode()
    head = f'<?xml version="1.0"?><!DOCTYPE l [<!ENTITY l0 "0">{_LAUGHS}]>'
    text = text.replace('<?xml version="1.0"?>', head).replace("0.0 0.0", "&l9;", 1)
    yield from (text.encode(), text.encode("utf-16"))


def _npz() -> Iterator[bytes]:
    """Yield archives with a member of 400 MB zeros, with a true or a false header."""
    stream = io.BytesIO()
    mesh = samples.squares(3)
    np.savez(stream, points=mesh.points, cell_offsets=[0, 3], cell_vertices=[0, 1, 2])
    plain = stream.getvalue()
    for content, names in ((_native(), ("face_vertices", "face_offsets", "meta", "level_0")),
                           (plain, ("cell_vertices",))):  # fmt: skip
        for name in names:
            yield _swollen(content, f"{name}.npy", lie=False)
    yield _swollen(plain, "points.npy", lie=True)


def _system() -> Iterator[bytes]:
    """Yield systems with an array of 400 MB zeros."""
    for content in matrix_files()[".system.npz"][:2]:
        for name in ("data", "indices", "indptr", "b", "block_offsets"):
            yield _swollen(content, f"{name}.npy", lie=False)
    yield _swollen(content, "data.npy", lie=True)


def _market() -> Iterator[bytes]:
    """Yield MatrixMarket headers that claim far more than the file contains."""
    right = b"%%MatrixMarket matrix array real general\n1 1\n1.0\n"
    for head in (
        "coordinate real general\n900000000000 900000000000 0\n",
        "coordinate real symmetric\n9 9 900000000000\n1 1 1\n",
        "array real general\n3000000 3000000\n",
        "array real symmetric\n999999999999999999 999999999999999999\n",
        "array integer general\n0 900000000000\n",
        "array real general\n0 1\n1.0\n",
        "array real general\n1 1\n1 x",
        "coordinate real general\n" + "%\n" * 1_000_000 + "1 1 1\n1 1 1\n",
    ):
        text = f"%%MatrixMarket matrix {head}".encode()
        yield packed({"m.mtx": text, "m_b.mtx": right})
        yield packed({"m.mtx": right, "m_b.mtx": text})


def _native() -> bytes:
    import tempfile
    from pathlib import Path

    from agglo_core import agglomerate

    with tempfile.TemporaryDirectory() as folder:
        mesh = samples.squares(3)
        write(file := Path(folder) / "m.npz", mesh, agglomerate(mesh, bisector="coordinate", n_parts=2))
        return file.read_bytes()


def _swollen(content: bytes, chosen: str, *, lie: bool) -> bytes:
    """Return an archive with one member replaced by zeros.

    If ``lie`` is set, the archive declares the size of the original member.
    """
    stream = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(stream, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == chosen:
                array, head = np.load(io.BytesIO(data)), io.BytesIO()
                count = array.shape[0] if lie else _BLOCKS * _BLOCK // array[:1].nbytes
                shape = (count, *array.shape[1:])
                header = {"descr": array.dtype.str, "fortran_order": False, "shape": shape}
                np.lib.format.write_array_header_1_0(head, header)
                size = len(data) if lie else len(head.getvalue()) + _BLOCKS * _BLOCK
                data = _deflated(head.getvalue())
            new.writestr(zipfile.ZipInfo(name), data)
    # Patch method and size of the member in both zip headers.
    found = bytearray(stream.getvalue())
    for mark, method, length, text in ((b"PK\x03\x04", 8, 22, 30), (b"PK\x01\x02", 10, 24, 46)):
        start = found.index(mark)
        while found[start + text :][: len(chosen)] != chosen.encode():
            start = found.index(mark, start + 1)
        found[start + method : start + method + 2] = struct.pack("<H", zipfile.ZIP_DEFLATED)
        found[start + length : start + length + 4] = struct.pack("<I", size)
    return bytes(found)


def _deflated(head: bytes) -> bytes:
    """Compress the header and the zeros as a stream of independent, repeatable blocks."""
    start, block = zlib.compressobj(9, zlib.DEFLATED, -15), zlib.compressobj(9, zlib.DEFLATED, -15)
    first = start.compress(head) + start.flush(zlib.Z_FULL_FLUSH)
    zeros = block.compress(bytes(_BLOCK)) + block.flush(zlib.Z_FULL_FLUSH)
    return first + _BLOCKS * zeros + block.flush()


def _toml() -> Iterator[bytes]:
    yield b"h_star = " + b"[" * 100_000
    yield b"h_star = " + b"[" * 300 + b"]" * 300
    yield b"seed = " + b"9" * 10_000
    yield b"n_parts = [" + b"4, " * 300 + b"]"
    yield b"n_parts = 4000000000000"
    yield b"h_factor = 1e-300"
    yield b'bisector = { name = "kmeans", iterations = 1000000000000 }'
    yield b"[a" + b".a" * 50_000 + b"]"
    yield b"kappa = 0x" + b"f" * 10_000
    yield b"#" * 3_000_000
    yield b'kind = "linear"\nmatrix = "/dev/zero"\nrhs = "/dev/zero"'


def _safetensors() -> Iterator[bytes]:
    """Yield headers that are deep or long, or claim missing arrays."""
    deep = b"[" * 200_000
    agglo = json.dumps({"__metadata__": {"agglo": "[" * 200_000}}).encode()
    huge = json.dumps({"a": {"dtype": "F64", "shape": [1 << 40], "data_offsets": [0, 1 << 43]}}).encode()
    for header in (deep, agglo, huge):
        yield struct.pack("<Q", len(header)) + header
    yield struct.pack("<Q", 1 << 40) + huge
    yield struct.pack("<Q", 6_000_000) + b" " * 6_000_000


def _geojson() -> Iterator[bytes]:
    """Yield deeply nested collections, and a collection with as many properties as features."""
    ring = [[0, 0], [1, 0], [1, 1], [0, 0]]
    square = {"type": "Polygon", "coordinates": [ring]}
    yield b'{"type": "FeatureCollection", "features": ' + b"[" * 100_000
    nested = b'{"type": "Polygon", "coordinates": ' + b"[" * 900 + b"]" * 900 + b"}"
    yield b'{"type": "FeatureCollection", "features": [{"type": "Feature", "geometry": ' + nested + b"}]}"
    features = [{"type": "Feature", "geometry": square, "properties": {f"p{i}": i}} for i in range(5000)]
    yield json.dumps({"type": "FeatureCollection", "features": features}).encode()
