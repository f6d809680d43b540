"""Random damage to files, as caused by disks, editors, transfers and other programs."""

from __future__ import annotations

import io
import json
import re
import zipfile
from collections.abc import Callable
from contextlib import suppress

import numpy as np
from fuzz.bombs import bombs
from fuzz.several import SEVERAL

from agglo_core import AggloError, Mesh

__all__ = ["damaged"]

Rng = np.random.Generator
_NUMBERS = [b"0", b"-1", b"1", b"2147483648", b"-9223372036854775808", b"18446744073709551615"]
_NUMBERS += [b"1000000000000", b"1e308", b"-1e-320", b"nan", b"inf", b"0x10", b"1.5", b""]


def damaged(rng: Rng, suffix: str, content: bytes) -> bytes:
    """Apply one to three random changes to a file, in archives mostly to a member or its values.

    One file in thirty is a bomb instead, and every other bomb is changed as well.
    """
    if rng.random() < 1 / 30 and (found := bombs(suffix)):
        content = found[rng.integers(len(found))]
        change = _damaged_member if suffix in SEVERAL else _renumber
        return content if rng.random() < 0.5 else change(rng, content)
    if suffix.endswith(".npz") and rng.random() < 0.75:
        return (_damaged_member if rng.random() < 0.4 else _damaged_values)(rng, content)
    if suffix in SEVERAL:
        return _damaged_member(rng, content)
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        content = _CHANGES[rng.integers(len(_CHANGES))](rng, content)
    return content


def _damaged_member(rng: Rng, content: bytes) -> bytes:
    """Change a member of an archive and keep the checksums right, so that readers reach the change."""
    stream = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(stream, "w") as new:
        names = old.namelist()
        chosen = rng.choice(names)
        for name in names:
            data = old.read(name)
            new.writestr(name, _CHANGES[rng.integers(len(_CHANGES))](rng, data) if name == chosen else data)
    return stream.getvalue()


def _damaged_values(rng: Rng, content: bytes) -> bytes:
    """Change a few numbers in an archive, and update the fingerprint."""
    # Replace one to three numbers by near or other values.
    with np.load(io.BytesIO(content)) as archive:
        arrays = {name: archive[name].copy() for name in archive}
    numbers = [name for name, each in arrays.items() if each.dtype.kind in "iuf" and name != "meta"]
    values = arrays[rng.choice(numbers)].reshape(-1)
    for place in rng.integers(0, len(values), rng.integers(1, 4)):
        near, other = values[place] + rng.integers(-1, 2), values[rng.integers(len(values))]
        values[place] = (near, other, other, -values[place])[rng.integers(4)]
    # Update the fingerprint if the mesh is still valid.
    if "meta" in arrays:
        meta = json.loads(arrays["meta"].tobytes())
        with suppress(AggloError):
            mesh = Mesh(*(arrays[name] for name in ("points", "face_offsets", "face_vertices", "face_cells")))
            meta["fingerprint"] = mesh.fingerprint
        arrays["meta"] = np.frombuffer(json.dumps(meta).encode(), np.uint8)
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, **arrays)
    return stream.getvalue()


def _span(rng: Rng, content: bytes) -> tuple[int, int]:
    """Return a random range, with uniform logarithm of the length."""
    start = int(rng.integers(0, len(content) + 1))
    return start, min(len(content), start + int(len(content) ** rng.random()))


def _flip(rng: Rng, content: bytes) -> bytes:
    changed = bytearray(content)
    for _ in range(min(len(changed), int(rng.integers(1, 9)))):
        changed[rng.integers(len(changed))] = rng.integers(256)
    return bytes(changed)


def _retype(rng: Rng, content: bytes) -> bytes:
    """Replace a few digits by digits or letters by letters, so that numbers and base64 stay well-formed."""
    kinds = (b"0123456789", b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz")
    kind = np.frombuffer(kinds[rng.integers(2)], np.uint8)
    changed = np.frombuffer(content, np.uint8).copy()
    places = np.flatnonzero(np.isin(changed, kind))
    if len(places):
        chosen = rng.choice(places, rng.integers(1, 4))
        changed[chosen] = rng.choice(kind, len(chosen))
    return changed.tobytes()


def _cut(rng: Rng, content: bytes) -> bytes:
    return content[: rng.integers(0, len(content) + 1)]


def _delete(rng: Rng, content: bytes) -> bytes:
    start, stop = _span(rng, content)
    return content[:start] + content[stop:]


def _double(rng: Rng, content: bytes) -> bytes:
    start, stop = _span(rng, content)
    return content[:stop] + content[start:]


def _renumber(rng: Rng, content: bytes) -> bytes:
    """Replace a number in the text by another number."""
    found = list(re.finditer(rb"(?<![\w.])-?\d+(\.\d+)?", content))
    if not found:
        return _flip(rng, content)
    old = found[rng.integers(len(found))]
    value = float(old[0])
    near = [b"%r" % (value * scale) for scale in (0.9, 1.01, -1)] if b"." in old[0] else []
    whole = int(value) if np.isfinite(value) else 0  # a bomb may have thousands of digits
    near = near or [b"%d" % (whole + step) for step in (-1, 1, 2)]
    other = found[rng.integers(len(found))][0]
    choices = [*4 * near, *4 * [other], *_NUMBERS]
    return content[: old.start()] + choices[rng.integers(len(choices))] + content[old.end() :]


def _swap(rng: Rng, content: bytes) -> bytes:
    """Swap two sections of equal rank: lines, elements or values."""
    mark = (b"\n", b"<", b" ", b"$")[rng.integers(4)]
    parts = content.split(mark)
    if len(parts) < 4:
        return _delete(rng, content)
    a, b = rng.integers(1, len(parts), 2)
    parts[a], parts[b] = parts[b], parts[a]
    return mark.join(parts)


_CHANGES: tuple[Callable[[Rng, bytes], bytes], ...] = (
    *(_flip, _cut, _delete, _double, _swap),
    *(_renumber, _renumber, _renumber, _retype, _retype, _retype),
)
