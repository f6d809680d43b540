"""Where the machine code of kernels is kept: in numba's folders, and beside this file if it was installed.

No other file knows ``numba.core.caching`` from within.
"""

from __future__ import annotations

import glob
import inspect
import logging
import re
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile

__all__ = ["INSTALLED", "KernelCache", "source_stamp", "sources"]

INSTALLED = Path(__file__).with_name("compiled")
"""Folder of the kernels that were compiled when the wheel was built; absent in a checkout."""

_log = logging.getLogger("agglo")
_HERE = Path(__file__).parent
_IMPORT = re.compile(r"^[ \t]*(?:from|import)\b(?:[^\n(]*\([^)]*\)|[^\n]*)", re.MULTILINE)
_OFFER = re.compile(r"^(?:def (\w+)|(\w+)(?:: [^=\n]+)? = )", re.MULTILINE)


class _Nowhere:
    """The last resort of numba's cache where no folder is writable: what is installed is still found."""

    def __init__(self, function: Any) -> None:
        self._line = str(function.__code__.co_firstlineno)

    @classmethod
    def from_function(cls, function: Any, file: str) -> _Nowhere | None:
        return cls(function) if Path(file).is_file() else None

    def get_cache_path(self) -> str:
        return str(_HERE)

    def get_source_stamp(self) -> str:
        return ""

    def get_disambiguator(self) -> str:
        return self._line


class _Files(CompileResultCacheImpl):
    _locator_classes: list[type[object]] = [*CompileResultCacheImpl._locator_classes, _Nowhere]  # noqa: RUF012


class _CacheFile(IndexDataCacheFile):
    """Index of the machine code of one kernel, in files that are named by signature and sources.

    Numba numbers these files. Of two processes that compile different signatures at once both may take the
    same number, and the index of one then leads to the machine code of the other: a kernel for float64
    was called with integers. A name that depends on the content alone cannot be taken twice.
    """

    def save(self, key: Any, data: Any) -> None:
        """Write the machine code of a signature, then the index, which is complete at every moment."""
        if Path(self._index_path).is_file() and not self._load_index():  # type: ignore[no-untyped-call]
            self._remove_stale()
        digest = sha256(f"{self._version} {self._source_stamp} {key}".encode()).hexdigest()[:20]
        name = f"{Path(self._index_name).stem}.{digest}.nbc"
        self._save_data(name, data)  # type: ignore[no-untyped-call]
        self._save_index({**self._load_index(), key: name})  # type: ignore[no-untyped-call]

    def _remove_stale(self) -> None:
        """Remove machine code of other sources, to which no index leads."""
        for file in Path(self._cache_path).glob(f"{glob.escape(Path(self._index_name).stem)}.*.nbc"):
            file.unlink(missing_ok=True)


class KernelCache(FunctionCache):
    """Numba's cache of one kernel, stamped by all sources it is compiled from; installed files come first.

    An entry is used for the same sources, versions of numba, numpy and Python, and processor only. Numba
    by itself looks at the file of the kernel alone, and keeps machine code although a function in another
    file that is compiled into it has changed.
    """

    _impl_class = _Files

    def __init__(self, function: Any, installed: Path = INSTALLED) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        file = Path(inspect.getfile(function))
        self._stamp = source_stamp(file) if file.is_file() else self._impl.locator.get_source_stamp()
        self._cache_file = self._index_in(Path(self._cache_path))
        self._installed = self._index_in(installed)

    @property
    def cache_path(self) -> str | None:
        """Folder of what was compiled on this machine, none where no folder is writable."""
        return None if isinstance(self._impl.locator, _Nowhere) else self._cache_path

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Machine code for a signature, or None."""
        target_context.refresh()
        key = self._index_key(sig, target_context.codegen())  # type: ignore[no-untyped-call]
        data = self._installed.load(key)
        if data is None:
            return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        return self._impl.rebuild(target_context, data)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled, if there is where."""
        if self.cache_path is None:
            _warn_unwritable()
        else:
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]

    def write_to(self, folder: Path) -> None:
        """Keep what is compiled from now on in a folder that is to become :data:`INSTALLED`."""
        self._cache_file = self._installed = self._index_in(folder)

    def _index_in(self, folder: Path) -> Any:
        package = self._py_func.__module__.rpartition(".")[0]
        name = f"{package}.{self._impl.filename_base}"
        return _CacheFile(str(folder), name, self._stamp)  # type: ignore[no-untyped-call]


@cache  # once per process
def _warn_unwritable() -> None:
    _log.warning(
        "no folder for compiled kernels is writable: they are compiled again in each run; "
        "set NUMBA_CACHE_DIR to a folder that is"
    )


@cache  # sources do not change while a process runs
def source_stamp(file: Path) -> str:
    """Hash of :func:`sources` and of the version of numpy, whose routines are compiled into kernels too."""
    digest = sha256(np.__version__.encode())
    for source in sorted(sources(file), key=lambda each: (each.parent.name, each.name)):
        digest.update(source.name.encode())
        digest.update(source.read_bytes())
    return digest.hexdigest()


def sources(file: Path) -> set[Path]:
    """Files from which the kernels in ``file`` are compiled: itself and what it imports, directly or not.

    Sought are files of the same folder, and of this one, by the words of the import statements: names of
    modules, and names that a file here defines, which plugins import from elsewhere. Too many do no harm.
    """
    found: set[Path] = set()
    ahead = {file} if file.is_file() else set()
    while ahead:
        source = ahead.pop()
        found.add(source)
        words = _words_of_imports(source)
        near = {other for other in source.parent.glob("*.py") if other.stem in words}
        ours = {} if source.parent == _HERE else _offers()
        ahead |= (near | {other for other, names in ours.items() if names & words}) - found
    return found


@cache
def _words_of_imports(source: Path) -> frozenset[str]:
    statements = _IMPORT.findall(source.read_text(encoding="utf-8"))
    return frozenset(word for each in statements for word in re.findall(r"\w+", each))


@cache
def _offers() -> dict[Path, frozenset[str]]:
    """Files of this folder, each with its own name and those it defines."""
    texts = {file: file.read_text(encoding="utf-8") for file in _HERE.glob("*.py")}
    return {
        file: frozenset({file.stem, *"".join(f" {a}{b}" for a, b in _OFFER.findall(text)).split()})
        for file, text in texts.items()
    }
