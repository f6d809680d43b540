"""Parse the dictionary syntax of OpenFOAM files: comments, strings, nested dictionaries and lists."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from agglo_core.arrays import Int, frozen_int
from agglo_core.errors import FileError
from agglo_core.files.text_numbers import integers, line_of

COMMENT = rb"//[^\n]*+|/\*(?:[^*]++|\*(?!/))*+\*/"
"""Pattern of a comment."""

SPACE = rb"(?:\s++|%b)*+" % COMMENT
"""Pattern of white space and comments."""

Table = dict[str, Any]
"""Dictionary entries: a nested dictionary, or a list with the words, strings, lists and label arrays of a
value.
"""

_DEPTH = 50  # limit on the nesting of dictionaries and lists
_SKIPPED = re.compile(SPACE)
_STRING = re.compile(rb'"(?:[^"\\]++|\\.)*+"', re.S)
_RUN = re.compile(rb'(?:[^\s";{}/]|/(?![/*])){1,1000}')
_COUNT = re.compile(rb"\d{1,18}")
_LABELS = re.compile(rb"((?:[-+\d\s]++|%b)*+)\)" % COMMENT)


class FoamParser:
    """Parser with a current position in the content of an OpenFOAM file.

    Each method advances past its result.

    Parameters
    ----------
    name : str
        Name of the file in error messages.
    content : bytes
    place : int
        Start position.
    label : str
        Type of binary labels; empty for text.
    most : int
        Maximum length of a list written as its length and one label.
    """

    def __init__(self, name: str, content: bytes, place: int = 0, label: str = "", most: int = 0) -> None:
        self.place = place
        self._name, self._content, self._label, self._most = name, content, label, most
        self._depth = 0

    def token(self) -> bytes:
        """Return the next word, quoted string, bracket or semicolon.

        The result is empty at the end of the file.
        """
        self._skip()
        mark = self._content[self.place : self.place + 1]
        if mark and mark in b"{}();":
            self.place += 1
            return mark
        match = (_STRING if mark == b'"' else _RUN).match(self._content, self.place)
        if match is None and mark:
            raise self._error("unterminated string" if mark == b'"' else "unterminated comment")
        word = match[0] if match is not None else b""
        if mark != b'"' and (b"(" in word or b")" in word):
            count = _COUNT.match(word)
            word = (
                count[0] if count and word[count.end() :].startswith((b"(", b")")) else _trim_brackets(word)
            )
        self.place += len(word)
        return word

    def table(self) -> Table:
        """Parse a dictionary whose opening brace has been read, up to its closing brace.

        For repeated keywords the last is kept.
        """
        entries: Table = {}
        self._enter()
        while (keyword := self.token()) != b"}":
            if keyword == b";":
                continue
            if not keyword or keyword in b"{()":
                raise self._expected("an entry or }", keyword)
            if keyword.startswith(b"#"):
                raise self._error(f"directives such as {_text(keyword)!r:.40} are not supported")
            entries[_text(keyword)] = self._value()
        self._depth -= 1
        return entries

    def named_tables(self) -> Iterator[tuple[str, Table]]:
        """Yield the names and dictionaries in a list ``n ( name {…} … )``.

        ``0`` may stand for an empty list.
        """
        word = self.token()
        declared = int(word) if _COUNT.fullmatch(word) else None
        word = word if declared is None else self.token()
        if not word and declared == 0:
            return
        if word != b"(":
            raise self._expected("a list in brackets", word)
        count = 0
        while (name := self.token()) != b")":
            if not name or name in b"{};(":
                raise self._expected("a name or )", name)
            word = self.token()
            if word != b"{":
                raise self._expected(f"{{ after the name {_text(name)!r}", word)
            yield _text(name), self.table()
            count += 1
        if declared not in (None, count):
            raise FileError(f"{self._name}: {declared} entries are declared, but {count} follow")

    def _value(self) -> Any:
        """Parse the value of a key: a nested dictionary, or the items before the next semicolon."""
        word = self.token()
        if word == b"{":
            return self.table()
        parts: list[Any] = []
        while word != b";":
            if not word or word in b"})":
                raise self._expected("a value or ;", word)
            if word != b"List<label>":
                parts.append(self._part(word))
            elif self._label:
                parts.append(self._binary_labels())
            word = self.token()
        return parts

    def _part(self, word: bytes) -> Any:
        if word == b"{":
            return self.table()
        if word == b"(":
            return self._list()
        if _COUNT.fullmatch(word):
            self._skip()
            bracket = self._content[self.place : self.place + 1]
            if bracket in (b"(", b"{"):
                self.place += 1
                return self._list(int(word)) if bracket == b"(" else self._equal_labels(int(word))
        return word

    def _list(self, declared: int | None = None) -> Any:
        """Parse a list whose opening bracket has been read, as an array if it holds only integers."""
        match = _LABELS.match(self._content, self.place)
        if match is not None:
            labels = integers(re.sub(COMMENT, b" ", match[1]))
            if declared not in (None, len(labels)):
                raise self._error(f"{declared} labels are declared, but {len(labels)} follow")
            self.place = match.end()
            return labels
        parts: list[Any] = []
        self._enter()
        while (word := self.token()) != b")":
            if not word or word in b"};":
                raise self._expected("an item or )", word)
            parts.append(self._part(word))
        self._depth -= 1
        return parts

    def _equal_labels(self, count: int) -> Int:
        word, end = self.token(), self.token()
        if not _COUNT.fullmatch(word) or end != b"}":
            raise self._expected("one label and }", word)
        if count > self._most:
            raise self._error(f"a list of {count} equal labels is too long, expected at most {self._most}")
        return frozen_int(np.full(count, int(word)))

    def _binary_labels(self) -> Int:
        """Return the integers of a binary list ``n (…)``, or of the empty list ``0``."""
        word = self.token()
        if not _COUNT.fullmatch(word):
            raise self._expected("the number of labels", word)
        count, dtype = int(word), np.dtype(self._label)
        if count == 0 and self._content[self.place : self.place + 1] != b"(":
            return frozen_int([])
        if self.token() != b"(":
            raise self._error(f"expected a list after the number {count}")
        stop = self.place + count * dtype.itemsize
        if self._content[stop : stop + 1] != b")":
            raise self._error(
                f"the list of {count} {8 * dtype.itemsize}-bit labels is not closed by a bracket"
            )
        labels = np.frombuffer(self._content, dtype, count, self.place)
        self.place = stop + 1
        return frozen_int(labels)

    def _skip(self) -> None:
        match = _SKIPPED.match(self._content, self.place)
        self.place = match.end() if match is not None else self.place

    def _enter(self) -> None:
        self._depth += 1
        if self._depth > _DEPTH:
            raise self._error(f"dictionaries and lists are nested more than {_DEPTH} deep")

    def _expected(self, expected: str, word: bytes) -> FileError:
        text = repr(_text(word[:40])) if word else "the end of the file: truncated"
        return self._error(f"expected {expected}, found {text}")

    def _error(self, reason: str) -> FileError:
        return FileError(f"{self._name}: line {line_of(self._content, self.place)}: {reason}")


def word_in(table: Table, key: str) -> str:
    """Return the value of a key if it is a single word or string, otherwise an empty string."""
    value = table.get(key)
    return _text(value[0]) if isinstance(value, list) and len(value) == 1 and _is_word(value[0]) else ""


def number_in(table: Table, key: str) -> int:
    """Return the value of a key if it is a single non-negative integer, otherwise −1."""
    word = word_in(table, key).encode()
    return int(word) if _COUNT.fullmatch(word) else -1


def labels_in(table: Table, key: str) -> Int | None:
    """Return the value of a key if it is a single list of integers, otherwise None.

    ``0`` is the empty list.
    """
    value = table.get(key)
    if not isinstance(value, list) or len(value) != 1:
        return None
    if isinstance(value[0], np.ndarray):
        return value[0]
    return frozen_int([]) if _is_word(value[0]) and value[0] == b"0" else None


def _is_word(part: Any) -> bool:
    return isinstance(part, bytes)


def _trim_brackets(word: bytes) -> bytes:
    """Return a word up to its first unmatched closing bracket, such as ``wall(1)`` for ``wall(1))``."""
    depth = 0
    for match in re.finditer(rb"[()]", word):
        depth += 1 if match[0] == b"(" else -1
        if depth < 0:
            return word[: match.start()]
    return word


def _text(word: bytes) -> str:
    """Decode a word, or the content of a quoted string."""
    content = re.sub(rb"\\(.)", rb"\1", word[1:-1]) if word[:1] == b'"' and len(word) > 1 else word
    return content.decode("utf-8", "replace")
