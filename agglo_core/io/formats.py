"""Formats of a registry, and the choice of the one that reads or writes a file."""

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
_HEAD = 512  # bytes by which a format may recognise a file


@dataclass(frozen=True)
class KnownFormat:
    """A :class:`~agglo_core.protocols.Format` that can be used, with its record and its suffixes."""

    record: Record
    tool: Any
    suffixes: tuple[str, ...]

    @property
    def title(self) -> str:
        """Its name in error messages."""
        return describe(self.record)

    def has(self, attribute: str) -> bool:
        """Return True if it has this method, or this optional attribute with a true value."""
        return bool(getattr(self.tool, attribute, False))


@dataclass(frozen=True)
class Formats:
    """The formats of a registry, in the order in which they are asked.

    Agglo's own come first, then those of plugins, then those of last resort. Only a format that claims the
    suffix of the file is built, when its turn comes: the modules of the others are not imported.

    Attributes
    ----------
    registry : Registry
    options : mapping
        What the format that reads or writes is built with.
    """

    registry: Registry
    options: Mapping[str, Any] = field(default_factory=dict)

    def first_accepted(self, path: Path, read: Callable[[KnownFormat, Path], T]) -> T:
        """Return what ``read`` makes of the file with the first format that claims and accepts it.

        If none does, those that recognise its content are asked, whatever its name. Of a folder those are
        tried that recognise it.

        Raises
        ------
        FileError
            If no format claims the file or folder, or if several do and each refuses it.
        AggloError
            Why the only one that claims it refuses it.
        PluginError
            If one misbehaves; no other is asked then.
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
        """The first format that claims the file and writes.

        Raises
        ------
        FileError
            If there is none; lists what is known.
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
        """Yield the formats that have the suffix of a file, those of last resort after the others."""
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
        """Yield the formats that do not claim a file by its name, but by how its content begins."""
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
        """Yield the formats that can be used, each built when its turn comes."""
        built = (self._usable(record) for record in self._records())
        return (known for known in built if known is not None)

    def _usable(self, record: Record) -> KnownFormat | None:
        """Build a format; None if it cannot be used."""
        try:
            return self._build(record)
        except AggloError:
            return None

    def _records(self) -> list[Record]:
        """List the records of all formats, agglo's own first."""
        return sorted(self.registry.list("format"), key=lambda record: not record.in_tree)

    def _build(self, record: Record) -> KnownFormat:
        """Build a format; raises AggloError with the reason why it cannot be used."""
        if record.state != "ok":
            raise PluginError(f"{describe(record)}: {unusable(record)}")
        tool = self.registry.assemble(record, {})
        return KnownFormat(record, tool, _declared_suffixes(record) or _suffixes_of(tool, describe(record)))

    def _unknown(self, path: Path, *, writing: bool) -> FileError:
        """Make the error for a file that no format claims; it names all that cannot be used."""
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
        """Say why a format cannot be used; empty if it can."""
        try:
            self._build(record)
        except AggloError as error:
            return str(error)
        return ""

    def _expected(self, method: str) -> str:
        """List the suffixes of all formats that read, or write."""
        usable = [known for known in self._all() if known.has(method)]
        suffixes = dict.fromkeys(suffix for known in usable for suffix in known.suffixes)
        if not suffixes:
            return f"there is no format that could {method} it: agglo's own come with its plugin 'defaults'"
        return f"expected one of {' '.join(suffixes)}"


def _claims(suffixes: tuple[str, ...], path: Path) -> bool:
    """Return True if the name of a file ends in one of the suffixes."""
    name = path.name.lower()
    return any(name.endswith(suffix) and name != suffix for suffix in suffixes)


def _declared_suffixes(record: Record) -> tuple[str, ...]:
    return record.component.suffixes if record.component is not None else ()


def _has_magic(record: Record, head: bytes) -> bool:
    """Return True if a file begins as the format declares."""
    magic = record.component.magic if record.component is not None else ""
    return bool(magic) and re.search(magic.encode("latin-1"), head) is not None


def _recognises(known: KnownFormat, head: bytes) -> bool:
    """Ask a format that declares no suffixes for a file by its method."""
    if not known.has("recognises"):
        return False
    with attributed(known.title):
        return bool(known.tool.recognises(head))


def _suffixes_of(tool: Any, title: str) -> tuple[str, ...]:
    """Suffixes of a format that declares none: its attribute; raises PluginError if that is not valid."""
    with attributed(title):
        suffixes = getattr(tool, "suffixes", ())
    if not isinstance(suffixes, tuple) or not suffixes:
        raise PluginError(f"{title}: its suffixes are {shown(suffixes)}, expected a tuple such as ('.vtu',)")
    for suffix in suffixes:
        if not is_suffix(suffix):
            form = "lower case after a dot, such as '.vtu'"
            raise PluginError(f"{title}: its suffix {shown(suffix)} is not of the form: {form}")
    return suffixes
