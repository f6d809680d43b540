"""Select the format that reads or writes a file from the formats of a registry."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar

from agglo_core.errors import AggloError, FileError, PluginError
from agglo_core.files.regular import without_mark
from agglo_core.io.foreign.unread import why_unread
from agglo_core.registry import Record, Registry, describe
from agglo_core.registry.attribution import attributed
from agglo_core.registry.containment import shown
from agglo_core.registry.declarations import is_suffix
from agglo_core.registry.records import unusable

T = TypeVar("T")
_log = logging.getLogger("agglo")
_HEAD = 512  # bytes for recognition by content


@dataclass(frozen=True)
class KnownFormat:
    """A usable :class:`~agglo_core.protocols.Format` with its record and suffixes."""

    record: Record
    tool: Any
    suffixes: tuple[str, ...]

    @property
    def title(self) -> str:
        """Name for error messages."""
        return describe(self.record)

    def has(self, attribute: str) -> bool:
        """Return True if the format has this method, or this optional attribute with a true value."""
        return bool(getattr(self.tool, attribute, False))


@dataclass(frozen=True)
class Formats:
    """The formats in a registry, by precedence.

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
        """Return the result of ``read`` for the first format that claims and accepts the file.

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
        for known in (
            self._of_folder(path) if folder else chain(self._claiming(path), self._recognising(path))
        ):
            try:
                answer = read(self._with_options(known), path)
            except PluginError:
                raise
            except AggloError as error:
                refusals.append((known.title, error))
                continue
            for title, reason in refusals:
                _log.info("%s: %s refused it (%s); read by %s", path, title, reason, known.title)
            return answer
        if not refusals:
            raise FileError("is a folder, expected a file") if folder else self._unknown(path, writing=False)
        if len(refusals) == 1:
            raise refusals[0][1]
        reasons = "; ".join(f"{title}: {reason}" for title, reason in refusals)
        raise FileError(f"each format for such files refuses it: {reasons}")

    def writer(self, path: Path) -> KnownFormat:
        """Return the first format that claims and writes the file.

        Raises
        ------
        FileError
            If there is none, with a list of the known suffixes.
        """
        readers = []
        for known in self._claiming(path):
            if known.has("write"):
                return self._with_options(known)
            readers.append(known.title)
        if readers:
            raise FileError(
                f"{' and '.join(readers)} can read such files, but not write them; {self._expected('write')}"
            )
        raise self._unknown(path, writing=True)

    def _with_options(self, known: KnownFormat) -> KnownFormat:
        if not self.options:
            return known
        return replace(known, tool=self.registry.assemble(known.record, self.options))

    def _claiming(self, path: Path) -> Iterator[KnownFormat]:
        """Yield the formats with the suffix of a file, last resorts at the end."""
        late = []
        for record in self._records():
            declared = _declared_suffixes(record)
            if declared and not _claims(declared, path):
                continue
            known = self._usable(record)
            if known is None or not _claims(known.suffixes, path):
                continue
            if known.has("last_resort"):
                late.append(known)
            else:
                yield known
        yield from late

    def _recognising(self, path: Path) -> Iterator[KnownFormat]:
        """Yield the formats that recognise the first bytes of a file without claiming its name."""
        with open(path, "rb") as stream:
            head = without_mark(stream.read(_HEAD))
        for record in self._records() if head else ():
            declared = bool(_declared_suffixes(record))
            if declared and not _has_magic(record, head):
                continue
            known = self._usable(record)
            if known is None or _claims(known.suffixes, path):
                continue
            if declared or _recognises(known, head):
                _log.info("%s: by its content it is a file of %s", path, known.title)
                yield known

    def _of_folder(self, folder: Path) -> Iterator[KnownFormat]:
        """Yield the formats that recognise a folder."""
        for known in self._all():
            if not known.has("recognises_folder"):
                continue
            with attributed(known.title, spare=(OSError,)):
                recognised = known.tool.recognises_folder(folder)
            if recognised:
                yield known

    def _all(self) -> Iterator[KnownFormat]:
        """Yield the usable formats, each built when its turn comes."""
        built = (self._usable(record) for record in self._records())
        return (known for known in built if known is not None)

    def _usable(self, record: Record) -> KnownFormat | None:
        """Build a format, or return None if it is unusable."""
        try:
            return self._build(record)
        except AggloError:
            return None

    def _records(self) -> list[Record]:
        """List the records of all formats, built-in formats first."""
        return sorted(self.registry.list("format"), key=lambda record: not record.in_tree)

    def _build(self, record: Record) -> KnownFormat:
        """Build a format, or raise AggloError with the reason why it is unusable."""
        if record.state != "ok":
            raise PluginError(f"{describe(record)}: {unusable(record)}")
        tool = self.registry.assemble(record, {})
        return KnownFormat(record, tool, _declared_suffixes(record) or _suffixes_of(tool, describe(record)))

    def _unknown(self, path: Path, *, writing: bool) -> FileError:
        """Create the error for a file that no format claims, with all unusable formats and plugins."""
        given = f"unknown suffix {path.suffix!r}" if path.suffix else "no suffix"
        known = None if writing else why_unread(path)
        given = known or given
        lines = [f"{given}; {self._expected('write' if writing else 'read')}"]
        formats = [reason for record in self._records() if (reason := self._fault(record))]
        plugins = [f"{describe(r)}: {r.reason}" for r in self.registry.list() if r.kind == "plugin"]
        for what, reasons in (("formats", formats), ("plugins", plugins)):
            if reasons:
                lines.append(f"{what} that cannot be used: {'; '.join(reasons)}")
        return FileError("; ".join(lines))

    def _fault(self, record: Record) -> str:
        """Return the reason why a format is unusable, or an empty string."""
        try:
            self._build(record)
        except AggloError as error:
            return str(error)
        return ""

    def _expected(self, method: str) -> str:
        """List the suffixes of all formats with this method (read or write)."""
        usable = [known for known in self._all() if known.has(method)]
        suffixes = dict.fromkeys(suffix for known in usable for suffix in known.suffixes)
        if not suffixes:
            return f"there is no format that could {method} it: agglo's own come with its plugin 'defaults'"
        return f"expected one of {' '.join(suffixes)}"


def _claims(suffixes: tuple[str, ...], path: Path) -> bool:
    """Return True if a file name ends in one of the suffixes."""
    name = path.name.lower()
    return any(name.endswith(suffix) and name != suffix for suffix in suffixes)


def _declared_suffixes(record: Record) -> tuple[str, ...]:
    return record.component.suffixes if record.component is not None else ()


def _has_magic(record: Record, head: bytes) -> bool:
    """Return True if a file begins as the format declares."""
    magic = record.component.magic if record.component is not None else ""
    return bool(magic) and re.search(magic.encode("latin-1"), head) is not None


def _recognises(known: KnownFormat, head: bytes) -> bool:
    """Call ``recognises`` for a format without declared suffixes."""
    if not known.has("recognises"):
        return False
    with attributed(known.title):
        return bool(known.tool.recognises(head))


def _suffixes_of(tool: Any, title: str) -> tuple[str, ...]:
    """Return the ``suffixes`` attribute of a format without declared suffixes.

    Raises PluginError if it is invalid.
    """
    with attributed(title):
        suffixes = getattr(tool, "suffixes", ())
    if not isinstance(suffixes, tuple) or not suffixes:
        raise PluginError(f"{title}: its suffixes are {shown(suffixes)}, expected a tuple such as ('.vtu',)")
    for suffix in suffixes:
        if not is_suffix(suffix):
            form = "lower case after a dot, such as '.vtu'"
            raise PluginError(f"{title}: its suffix {shown(suffix)} is not of the form: {form}")
    return suffixes
