"""Split Gmsh files into sections and read the numbers in them, from text or binary files."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.errors import FileError
from agglo_core.files.text_numbers import line_of, reals

_TITLE = re.compile(rb"\s*\$(\w+)[ \t\r]*(?:\n|\Z)")
_LARGEST = 1 << 53  # larger integers are not exact as doubles, the type for text


class Header(NamedTuple):
    """Contents of the section ``$MeshFormat``.

    Attributes
    ----------
    version : str
        "2", "4.0" or "4.1".
    order : str
        "<" or ">" for binary files, "" for text.
    size : int
        Bytes of a ``size_t`` in binary files.
    """

    version: str
    order: str
    size: int


def sections(content: bytes) -> Iterator[tuple[str, int, int]]:
    """Yield the name of each section with start and end of its content, in file order.

    Raises
    ------
    FileError
        For a section without an end, or content outside sections.
    """
    place = 0
    while content[place:].strip() if len(content) - place < 64 else True:
        title = _TITLE.match(content, place)
        if title is None:
            raise FileError(f"line {line_of(content, place)}: expected a section such as $Nodes")
        end = b"$End" + title[1]
        stop = content.find(b"\n" + end, title.end() - 1)
        if stop < 0:
            raise FileError(f"truncated: ${title[1].decode()} has no {end.decode()}")
        yield title[1].decode(), title.end(), stop + 1
        place = stop + 1 + len(end)


def gmsh_header(body: bytes, nodes: bytes) -> Header:
    """Determine version and encoding from the sections ``$MeshFormat`` and ``$Nodes``.

    Gmsh writes version 4.0 as 4, other programs write 4.1 as 4. The length of the first line of ``$Nodes``
    distinguishes them.

    Raises
    ------
    FileError
        For versions other than 2.x, 4.0 and 4.1.
    """
    line, _, tail = body.partition(b"\n")
    words = line.decode("ascii", "replace").split()
    if len(words) < 3 or words[1] not in ("0", "1") or words[2] not in ("4", "8"):
        raise FileError(f"$MeshFormat is {' '.join(words)[:40]!r}, expected a line such as '4.1 0 8'")
    version = words[0] if words[0] in ("4.0", "4.1") else words[0].split(".")[0]
    if words[0] == "4":
        version = "4.0" if words[1] == "0" and len(nodes.partition(b"\n")[0].split()) == 2 else "4.1"
    if version not in ("2", "4.0", "4.1"):
        raise FileError(f"Gmsh format version {words[0][:10]} is not supported, expected 2.2, 4.0 or 4.1")
    orders = {b"\1\0\0\0": "<", b"\0\0\0\1": ">"}
    if words[1] == "1" and tail[:4] not in orders:
        raise FileError("$MeshFormat of a binary file lacks the number 1, which gives the byte order")
    return Header(version, orders[tail[:4]] if words[1] == "1" else "", int(words[2]))


def decode_name(name: bytes) -> str:
    """Decode a name as UTF-8, or as Latin-1 (written by older programs) if it is not valid UTF-8."""
    try:
        return name.decode("utf-8")
    except UnicodeDecodeError:
        return name.decode("latin-1")


@dataclass
class Numbers:
    """Cursor that reads the numbers of one section in sequence.

    Every method raises FileError if the section is too short or a value is not an integer where required.
    """

    name: str
    content: bytes
    place: int
    stop: int
    header: Header
    _text: Float | None = field(default=None, init=False)

    def line(self) -> bytes:
        """Return the next text line (titles and counts are text even in binary files)."""
        end = self.content.find(b"\n", self.place, self.stop)
        if end < 0:
            raise self._short()
        line = self.content[self.place : end].strip()
        self.place = end + 1
        return line

    def line_count(self) -> int:
        """Read the next line, which holds a single non-negative integer."""
        line = self.line()
        if not re.fullmatch(rb"\d{1,18}", line):
            raise FileError(f"${self.name}: expected a count, found {line[:20]!r}")
        return int(line)

    def ints(self, n: int) -> Int:
        """Read the next n 4-byte integers ``(n,)``."""
        return self._whole(self._take("i4", n))

    def sizes(self, n: int) -> Int:
        """Read the next n integers of type ``size_t`` ``(n,)``."""
        return self._whole(self._take(f"u{self.header.size}", n))

    def reals(self, n: int) -> Float:
        """Read the next n doubles ``(n,)``."""
        return frozen_float(self._take("f8", n))

    def rows(self, n: int, width: int) -> tuple[Int, Float]:
        """Read n rows, each with one 4-byte integer and ``width`` doubles, as ``(n,)`` and ``(n, width)``."""
        if not self.header.order:
            table = self._take("f8", n * (1 + width)).reshape(n, 1 + width)
            return self._whole(table[:, 0]), frozen_float(table[:, 1:])
        table = self._take([("number", "i4"), ("values", "f8", (width,))], n)
        return frozen_int(table["number"]), frozen_float(table["values"])

    def rest(self) -> Int:
        """Read all remaining numbers of the section as integers (4 bytes each in binary files)."""
        if self.header.order:
            return self.ints((self.stop - self.place) // 4)
        return self.ints(len(self._values()))

    def _take(self, dtype: Any, n: int) -> NDArray[Any]:
        if n < 0:
            raise FileError(f"${self.name}: a count is {n}, expected 0 or more")
        if not self.header.order:
            values = self._values()
            if n > len(values):
                raise self._short()
            self._text = values[n:]
            return values[:n]
        kind = np.dtype(dtype).newbyteorder(self.header.order)
        start, self.place = self.place, self.place + n * kind.itemsize
        if self.place > self.stop:
            raise self._short()
        return np.frombuffer(self.content, kind, n, start)

    def _values(self) -> Float:
        if self._text is None:
            self._text = reals(self.content, self.place, self.stop)
        return self._text

    def _whole(self, values: NDArray[Any]) -> Int:
        if values.dtype.kind == "u" and values.size and values.max() > _LARGEST:
            raise FileError(f"${self.name} holds the number {values.max()}, which is too large")
        if values.dtype.kind == "f":
            wrong = values[~(np.abs(values) < _LARGEST) | (values != np.floor(values))]
            if len(wrong):
                raise FileError(f"${self.name}: expected a whole number, found {wrong[0]:g}")
        return frozen_int(values.astype(np.int64))

    def _short(self) -> FileError:
        return FileError(f"truncated: ${self.name} ends before its last number")
