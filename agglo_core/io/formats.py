"""The formats of a registry: which there are, and which of them reads or writes a file."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar

from agglo_core.errors import AggloError, FileError, PluginError
from agglo_core.files.regular import without_mark
from agglo_core.io.foreign.unread import why_unread
from agglo_core.registry import Record, Registry, describe
from agglo_core.registry.attribution import attributed
from agglo_core.registry.containment import shown
from agglo_core.registry.records import unusable

T = TypeVar("T")
_log = logging.getLogger("agglo")
_HEAD = 512  # bytes by which a format may recognise a file


@dataclass(frozen=True)
class KnownFormat:
    """A :class:`~agglo_core.protocols.Format` that can be used, with its record."""

    record: Record
    tool: Any

    @property
    def title(self) -> str:
        """Its name in error messages."""
        return describe(self.record)

    def has(self, attribute: str) -> bool:
        """Whether it has this method, or this optional attribute with a true value."""
        return bool(getattr(self.tool, attribute, False))

    def claims(self, path: Path) -> bool:
        """Whether the name of the file ends in one of its suffixes."""
        name = path.name.lower()
        return any(name.endswith(suffix) and name != suffix for suffix in self.tool.suffixes)


@dataclass(frozen=True)
class Formats:
    """The formats of a registry, in the order in which they are asked.

    Agglo's own come first, then those of plugins, then those of last resort. Each is built when its turn
    comes: once one accepts the file, the modules of the others are not imported.

    Attributes
    ----------
    registry : Registry
    options : mapping
        What the format that reads or writes is built with.
    """

    registry: Registry
    options: Mapping[str, Any] = field(default_factory=dict)

    def first_accepted(self, path: Path, read: Callable[[KnownFormat], T]) -> T:
        """What ``read`` returns of the first format that claims the file and accepts it.

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
                answer = read(self._with_options(known))
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
        return KnownFormat(known.record, self.registry.assemble(known.record, self.options))

    def _claiming(self, path: Path) -> Iterator[KnownFormat]:
        late = []
        for known, _ in self._survey():
            if known is None or not known.claims(path):
                continue
            if known.has("last_resort"):
                late.append(known)
            else:
                yield known
        yield from late

    def _recognising(self, path: Path) -> Iterator[KnownFormat]:
        """Those that do not claim the file by its name, but by how its content begins."""
        with open(path, "rb") as stream:
            head = without_mark(stream.read(_HEAD))
        for known, _ in self._survey():
            if known is None or not known.has("recognises") or known.claims(path) or not head:
                continue
            with attributed(known.title):
                recognised = known.tool.recognises(head)
            if recognised:
                _log.info("%s: by its content it is a file of %s", path, known.title)
                yield known

    def _of_folder(self, folder: Path) -> Iterator[KnownFormat]:
        """Yield the formats that recognise a folder."""
        for known, _ in self._survey():
            if known is None or not known.has("recognises_folder"):
                continue
            with attributed(known.title, spare=(OSError,)):
                recognised = known.tool.recognises_folder(folder)
            if recognised:
                yield known

    def _survey(self) -> Iterator[tuple[KnownFormat | None, str]]:
        """Each format, agglo's own first: what can be used, or None and why it cannot be."""
        records = [record for record in self.registry.list() if record.kind == "format"]
        for record in sorted(records, key=lambda record: not record.in_tree):
            if record.state != "ok":
                yield None, f"{describe(record)}: {unusable(record)}"
                continue
            try:
                tool = self.registry.assemble(record, {})
            except AggloError as error:
                yield None, str(error)
                continue
            wrong = [suffix for suffix in tool.suffixes if not _is_suffix(suffix)]
            if wrong:
                form = "lower case after a dot, such as '.vtu'"
                yield None, f"{describe(record)}: its suffix {shown(wrong[0])} is not of the form: {form}"
            else:
                yield KnownFormat(record, tool), ""

    def _unknown(self, path: Path, *, writing: bool) -> FileError:
        """Why no format claims the file, with all that cannot be used: one of them might."""
        given = f"unknown suffix {path.suffix!r}" if path.suffix else "no suffix"
        known = None if writing else why_unread(path)
        given = known or given
        lines = [f"{given}; {self._expected('write' if writing else 'read')}"]
        formats = [reason for known, reason in self._survey() if known is None]
        plugins = [f"{describe(r)}: {r.reason}" for r in self.registry.list() if r.kind == "plugin"]
        for what, reasons in (("formats", formats), ("plugins", plugins)):
            if reasons:
                lines.append(f"{what} that cannot be used: {'; '.join(reasons)}")
        return FileError("; ".join(lines))

    def _expected(self, method: str) -> str:
        """The suffixes of all formats that read, or write."""
        usable = [known for known, _ in self._survey() if known is not None and known.has(method)]
        suffixes = dict.fromkeys(suffix for known in usable for suffix in known.tool.suffixes)
        if not suffixes:
            return f"there is no format that could {method} it: agglo's own come with its plugin 'defaults'"
        return f"expected one of {' '.join(suffixes)}"


def _is_suffix(suffix: object) -> bool:
    return isinstance(suffix, str) and suffix[:1] == "." and len(suffix) > 1 and suffix == suffix.lower()
