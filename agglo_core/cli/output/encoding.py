"""Output in any character encoding, with replacements such as ``<=`` for ``≤``.

The streams replace unencodable characters themselves. This covers tables, notes, help texts and output of
plugins. JSON is ASCII anyway.
"""

from __future__ import annotations

import codecs
import io
import sys
import unicodedata
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import TextIO

from agglo_core.cli.output.stdout import stdout
from agglo_core.registry.containment import printable

_ERRORS = "agglo_readable"
_ASCII = "agglo_ascii"

_INSTEAD = {
    **{"≤": "<=", "≥": ">=", "≠": "!=", "≈": "~", "∞": "inf", "−": "-", "–": "-", "—": "-", "×": "x"},
    **{"·": ".", "•": "*", "…": "...", "→": "->", "←": "<-", "↔": "<->", "√": "sqrt ", "∇": "grad "},
    **{"ᵀ": "^T", "²": "^2", "³": "^3", "⁻": "^-", "°": " deg", "“": '"', "”": '"', "‘": "'", "’": "'"},
    **{"§": "sec. ", "±": "+-", "½": "1/2", "∂": "d"},
}
_GREEK = {
    letter: unicodedata.name(letter).rpartition(" ")[2].lower().replace("lamda", "lambda")
    for letter in "αβγδεζηθικλμνξπρστυφχψωΓΔΘΛΞΠΣΦΨΩ"
}


def _substitute(character: str) -> str:
    """Replace a character by similar ASCII characters, or by its Unicode number."""
    replacement = _INSTEAD.get(character) or _GREEK.get(character)
    if replacement:
        return replacement
    if "\udc80" <= character <= "\udcff":  # a byte of a file name that is not text
        return f"\\x{ord(character) - 0xDC00:02x}"
    if "─" <= character <= "╿":
        return {"─": "-", "━": "-", "│": "|", "┃": "|"}.get(character, "+")
    if "▀" <= character <= "▟" or "⠀" <= character <= "⣿":  # bars and spinners
        return "#" if character < "⠀" else "*"
    ascii_text = unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode()
    return ascii_text or character.encode("ascii", "backslashreplace").decode()


def _replace(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(map(_substitute, error.object[error.start : error.end])), error.end


codecs.register_error(_ERRORS, _replace)


def _ascii_by_another_name(name: str) -> codecs.CodecInfo | None:
    """Provide the ASCII encoding under another name, as :mod:`click` replaces it by UTF-8 otherwise."""
    if name != _ASCII:
        return None
    real = codecs.lookup("ascii")
    return codecs.CodecInfo(
        real.encode,
        real.decode,
        real.streamreader,
        real.streamwriter,
        real.incrementalencoder,
        real.incrementaldecoder,
        name=_ASCII,
    )


@contextmanager
def readable_output() -> Iterator[None]:
    """Replace characters that stdout and stderr cannot encode, within the context."""
    codecs.register(_ascii_by_another_name)
    try:
        with ExitStack() as stack:
            for stream in (sys.stdout, sys.stderr):
                if isinstance(stream, io.TextIOWrapper):
                    stack.enter_context(_reconfigure_temporarily(stream))
            yield
    finally:
        codecs.unregister(_ascii_by_another_name)


@contextmanager
def _reconfigure_temporarily(stream: io.TextIOWrapper) -> Iterator[None]:
    encoding, errors = stream.encoding, stream.errors
    is_ascii = codecs.lookup(encoding).name == "ascii"
    stream.reconfigure(encoding=_ASCII if is_ascii else encoding, errors=_ERRORS)
    try:
        yield
    finally:
        with suppress(OSError, ValueError):  # closed, or unable to write its buffer
            stream.reconfigure(encoding=encoding, errors=errors)


def replace_unencodable(text: str, stream: TextIO | None = None) -> str:
    """Return a text with replacements for the characters that a stream (default: stdout) cannot encode."""
    stream = stdout() if stream is None else stream
    encoding = getattr(stream, "encoding", None) or "utf-8"
    return printable(text).encode(encoding, _ERRORS).decode(encoding)


def can_show(text: str, stream: TextIO | None = None) -> bool:
    """Return True if a stream (default: stdout) can encode all characters of the text."""
    return replace_unencodable(text, stream) == text
