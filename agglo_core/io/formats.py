"""Select the file format that reads or writes a file, among built-in formats and plugins."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar

from agglo_core.errors import AggloError, FileError, PluginError
from agglo_core.files.regular import strip_mark
from agglo_core.io.foreign.unread import why_unread
from agglo_core.registry import Record, Registry, describe
from agglo_core.registry.attribution import attributed
from agglo_core.registry.containment import shown
from agglo_core.registry.declarations import is_suffix
from agglo_core.registry.records import unusable
from agglo_core.suggestions import did_you_mean

T = TypeVar("T")
_log = logging.getLogger("agglo")
_HEAD = 512  # bytes for recognition by content
_SIMILAR = 0.7  # similarity of suggested suffixes: one letter of three may differ


@dataclass(frozen=True)
class KnownFormat:
    """A usable file format with its registry record and its file suffixes."""

    record: Record
    tool: Any
    suffixes: tuple[str, ...]

    @property
    def title(self) -> str:
        """Name of the format in error messages."""
        return describe(self.record)

    def has(self, attribute: str) -> bool:
        """Return True if the format defines this method, or this attribute with a true value."""
        return bool(getattr(self.tool, attribute, False))


@dataclass(frozen=True)
class Formats:
    """The file formats in a registry, in the order in which they are tried.

    Built-in formats come first, then plugins, then formats of last resort. A format is built only when its
    turn comes and it claims the suffix, so the modules of the others are not imported.

    Attributes
    ----------
    registry : Registry
    options : mapping
        Options for the format that reads or writes.
    """

    registry: Registry
    options: Mapping[str, Any] = field(default_factory=dict)

    def first_accepted(self, path: Path, read: Callable[[KnownFormat, Path], T]) -> T:
        """Apply ``read`` with each matching format until one accepts the file, and return the result.

        If none does, formats that recognise the content are tried, whatever the file name. For a folder, the
        formats that recognise it are tried.

        Raises
        ------
        FileError
            If no format claims the file or folder, or if several do and each rejects it.
        AggloError
            The reason of the only format that claims the file and rejects it.
        PluginError
            If a format misbehaves; no other format is tried then.
        """
        refusals: list[tuple[str, AggloError]] = []
        folder = path.is_dir()
        for file_format in (
            self._of_folder(path) if folder else chain(self._claiming(path), self._recognising(path))
        ):
            try:
                answer = read(self._with_options(file_format), path)
            except PluginError:
                raise
            except AggloError as error:
                refusals.append((file_format.title, error))
                continue
            for title, reason in refusals:
                _log.info("%s: %s could not read it (%s); read by %s", path, title, reason, file_format.title)
            return answer
        if not refusals:
            raise FileError("is a folder, expected a file") if folder else self._unknown(path, writing=False)
        if len(refusals) == 1:
            raise refusals[0][1]
        reasons = "; ".join(f"{title}: {reason}" for title, reason in refusals)
        raise FileError(f"none of the matching formats could read it: {reasons}")

    def writer(self, path: Path) -> KnownFormat:
        """Return the first format that has the suffix of the file and can write.

        Raises
        ------
        FileError
            If there is none, with the nearest suffixes that can be written.
        """
        readers = []
        for file_format in self._claiming(path):
            if file_format.has("write"):
                return self._with_options(file_format)
            readers.append(file_format.title)
        if readers:
            advice = self._advice(path, "write")
            raise FileError(f"{' and '.join(readers)} can read such files, but not write them{advice}")
        raise self._unknown(path, writing=True)

    def _with_options(self, file_format: KnownFormat) -> KnownFormat:
        if not self.options:
            return file_format
        return replace(file_format, tool=self.registry.assemble(file_format.record, self.options))

    def _claiming(self, path: Path) -> Iterator[KnownFormat]:
        """Yield the formats that have the suffix of a file, formats of last resort at the end."""
        late = []
        for record in self.records():
            declared = declared_suffixes(record)
            if declared and not _claims(declared, path):
                continue
            file_format = self.usable(record)
            if not isinstance(file_format, KnownFormat) or not _claims(file_format.suffixes, path):
                continue
            if file_format.has("last_resort"):
                late.append(file_format)
            else:
                yield file_format
        yield from late

    def _recognising(self, path: Path) -> Iterator[KnownFormat]:
        """Yield the formats that recognise the content of a file although its suffix is not theirs."""
        with open(path, "rb") as stream:
            head = strip_mark(stream.read(_HEAD))
        for record in self.records() if head else ():
            declared = bool(declared_suffixes(record))
            if declared and not _has_magic(record, head):
                continue
            file_format = self.usable(record)
            if not isinstance(file_format, KnownFormat) or _claims(file_format.suffixes, path):
                continue
            if declared or _recognises(file_format, head):
                _log.info("%s: recognised by its content as a file of %s", path, file_format.title)
                yield file_format

    def _of_folder(self, folder: Path) -> Iterator[KnownFormat]:
        """Yield the formats that recognise a folder as one of their meshes."""
        for file_format in self._all():
            if not file_format.has("recognises_folder"):
                continue
            with attributed(file_format.title, spare=(OSError,)):
                recognised = file_format.tool.recognises_folder(folder)
            if recognised:
                yield file_format

    def _all(self) -> Iterator[KnownFormat]:
        """Yield all usable formats, each constructed only when it is needed."""
        built = map(self.usable, self.records())
        return (known for known in built if isinstance(known, KnownFormat))

    def usable(self, record: Record) -> KnownFormat | AggloError:
        """Construct a format, or return the error with the reason why this fails."""
        try:
            return self._build(record)
        except AggloError as error:
            return error

    def records(self) -> list[Record]:
        """Return the registry records of all formats, built-in formats first."""
        return sorted(self.registry.list("format"), key=lambda record: not record.in_tree)

    def _build(self, record: Record) -> KnownFormat:
        """Construct a format, or raise AggloError with the reason why this fails."""
        if record.state != "ok":
            raise PluginError(f"{describe(record)}: {unusable(record)}")
        tool = self.registry.assemble(record, {})
        return KnownFormat(record, tool, declared_suffixes(record) or _suffixes_of(tool, describe(record)))

    def _unknown(self, path: Path, *, writing: bool) -> FileError:
        """Create the error for a file of unknown format, with a list of unusable formats and plugins."""
        problem = f"unknown suffix {path.suffix!r}" if path.suffix else "no suffix"
        explanation = None if writing else why_unread(path)
        lines = [explanation or problem + self._advice(path, "write" if writing else "read")]
        built = map(self.usable, self.records())
        formats = [str(error) for error in built if isinstance(error, AggloError)]
        plugins = [f"{describe(r)}: {r.reason}" for r in self.registry.list() if r.kind == "plugin"]
        for subject, reasons in (("formats", formats), ("plugins", plugins)):
            if reasons:
                lines.append(f"{subject} that cannot be used: {'; '.join(reasons)}")
        return FileError("; ".join(lines))

    def _advice(self, path: Path, method: str) -> str:
        """Return a hint to the nearest suffixes of formats that can ``read`` or ``write``."""
        formats = [file_format for file_format in self._all() if file_format.has(method)]
        suffixes = {suffix for file_format in formats for suffix in file_format.suffixes}
        if not suffixes:
            return f"; no format can {method} it: agglo's own formats belong to its plugin 'defaults'"
        hint = did_you_mean(path.suffix.lower(), suffixes, 3, _SIMILAR)
        return f"{hint}; the command 'agglo formats' lists all"


def _claims(suffixes: tuple[str, ...], path: Path) -> bool:
    """Return True if a file name ends in one of the suffixes."""
    name = path.name.lower()
    return any(name.endswith(suffix) and name != suffix for suffix in suffixes)


def declared_suffixes(record: Record) -> tuple[str, ...]:
    """Return the suffixes in the declaration of a format, empty if it declares none."""
    return record.component.suffixes if record.component is not None else ()


def _has_magic(record: Record, head: bytes) -> bool:
    """Return True if a file begins with the bytes that identify the format."""
    magic = record.component.magic if record.component is not None else ""
    return bool(magic) and re.search(magic.encode("latin-1"), head) is not None


def _recognises(file_format: KnownFormat, head: bytes) -> bool:
    """Return True if the format's method ``recognises`` accepts the first bytes of a file."""
    if not file_format.has("recognises"):
        return False
    with attributed(file_format.title):
        return bool(file_format.tool.recognises(head))


def _suffixes_of(tool: Any, title: str) -> tuple[str, ...]:
    """Return the file suffixes of a format from its attribute ``suffixes``.

    Raises PluginError if it is invalid.
    """
    with attributed(title):
        suffixes = getattr(tool, "suffixes", ())
    if not isinstance(suffixes, tuple) or not suffixes:
        raise PluginError(f"{title}: its suffixes are {shown(suffixes)}, expected a tuple such as ('.vtu',)")
    for suffix in suffixes:
        if not is_suffix(suffix):
            form = "a dot and lower-case characters, such as '.vtu'"
            raise PluginError(f"{title}: its suffix {shown(suffix)} must be {form}")
    return suffixes
