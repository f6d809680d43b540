"""Disk cache of compiled kernels: one folder per user, and in an installation another next to this file.

No other module uses the internals of ``numba.core.caching``.
"""

from __future__ import annotations

import glob
import inspect
import logging
import os
import pickle
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numba import config
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile, UserWideCacheLocator
from numba.misc.appdirs import AppDirs

from agglo_core.compiled import compile_lock
from agglo_core.compiled.cpu_levels import supported_levels
from agglo_core.lazy_names import names_in_stub

INSTALLED = Path(__file__).with_name("machine_code")
"""Folder of the kernels compiled when the wheel was built; absent in a checkout."""

_log = logging.getLogger("agglo")
_HERE = Path(__file__).parent
_CORE = Path(__file__).parents[1]  # the folder of the package
_COMPILER = Path(__file__).with_name("self_contained.py")
_HASH = 32  # length of a SHA-256 digest in bytes
_MOST_BYTES = 1 << 30  # limit of a user's folder, 25 times the machine code of all kernels
_IMPORT = re.compile(r"^from ([\w.]+) import (\([^)]*\)|[^\n]*)", re.MULTILINE)


class _UserFolder(UserWideCacheLocator):
    """The folder of a user's compiled kernels, shared by all environments and checkouts.

    Files are named by content, so that kernels are compiled once per computer and not once per installation.
    """

    def __init__(self, function: Any, file: str) -> None:
        super().__init__(function, file)  # type: ignore[no-untyped-call]
        own = AppDirs(appname="agglo", appauthor=False).user_cache_dir  # type: ignore[no-untyped-call]
        self._cache_path = str(Path(config.CACHE_DIR or own, "kernels"))  # type: ignore[attr-defined]


class _Nowhere:
    """Substitute for a cache folder if none is writable, so that installed kernels are still found."""

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
    _locator_classes: list[type[object]] = [  # noqa: RUF012
        _UserFolder,
        *CompileResultCacheImpl._locator_classes,
        _Nowhere,
    ]


class _CacheFiles(IndexDataCacheFile):
    """Files with the machine code of one kernel, one per signature, named by signature and sources.

    Numba numbers these files and keeps an index. If two processes compile different signatures at the same
    time, both may use one number, so that a kernel for float64 is called with integers, or one index
    overwrites the other. A name that depends only on the content needs no index.

    Each file begins with a hash of the rest. A file damaged by a full disk or a power failure counts as
    absent: unpickling it may fail in any way, and machine code with a wrong byte may crash the interpreter.
    """

    def save(self, key: Any, data: Any) -> None:
        """Write the machine code of a signature, and remove old files if the folder is too large."""
        _limit_size(Path(self._cache_path))
        self._save_data(self._name(key), (key, data))  # type: ignore[no-untyped-call]

    def load(self, key: Any) -> Any:
        """Read the machine code of a signature, or return None if its file is absent or damaged."""
        file = Path(self._cache_path, self._name(key))
        try:
            content = file.read_bytes()
        except OSError:
            return None
        with suppress(OSError):  # an installation may be write-protected
            os.utime(file)  # for _limit_size
        if sha256(content[_HASH:]).digest() != content[:_HASH]:
            return None
        kept, data = pickle.loads(content[_HASH:])
        return data if kept == key else None

    def lock(self, key: Any) -> Path:
        """Return the path of the file to lock while a process compiles a signature."""
        return Path(self._cache_path, self._name(key)).with_suffix(".lock")

    def flush(self) -> None:
        """Remove all files with machine code of the kernel."""
        name = glob.escape(Path(self._index_name).stem)
        for file in Path(self._cache_path).glob(f"{name}.*.nbc"):
            file.unlink(missing_ok=True)

    @contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[BytesIO]:
        """Collect the written content, then write its hash and the content to the file at once."""
        content = BytesIO()
        yield content
        with super()._open_for_write(filepath) as file:
            file.write(sha256(content.getvalue()).digest() + content.getvalue())

    @property
    def _stamp(self) -> str:
        return sha256(f"{self._version} {self._source_stamp}".encode()).hexdigest()[:10]

    def _name(self, key: Any) -> str:
        return f"{Path(self._index_name).stem}.{self._stamp}{sha256(str(key).encode()).hexdigest()[:10]}.nbc"


class KernelCache(FunctionCache):
    """Numba cache of one kernel, valid for unchanged source files, with installed machine code first.

    An entry is only used for equal sources, versions of numba, numpy and Python, and processor. Installed
    entries may instead be for a level whose features the processor has (``cpu_levels.py``). Numba's own cache
    has one folder per path of a source file. It considers only the kernel's file, and keeps machine code even
    if an inlined function in another file has changed.
    """

    _impl_class = _Files

    def __init__(self, function: Any, installed: Path = INSTALLED) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        file = Path(inspect.getfile(function))
        self._stamp = source_stamp(file) if file.is_file() else self._impl.locator.get_source_stamp()
        self._cache_file: _CacheFiles = self._files_in(Path(self._cache_path))
        self._installed = self._files_in(installed)
        self._attempted: set[Any] = set()  # signatures that this process has begun to compile

    @property
    def cache_path(self) -> str | None:
        """Folder for kernels compiled on this computer, or None if no folder is writable."""
        return None if isinstance(self._impl.locator, _Nowhere) else self._cache_path

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load the machine code for a signature, or return None if this process should compile it.

        While another process compiles the signature, wait for its result.
        """
        target_context.refresh()
        key = self._index_key(sig, target_context.codegen())  # type: ignore[no-untyped-call]
        for each in (key, *_keys_of_levels(key)):
            data = self._installed.load(each)
            if data is not None:
                return self._impl.rebuild(target_context, data)
        found = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        # Numba does not compile again what failed once, so that a second lock would never be released.
        if found is None and self.cache_path is not None and key not in self._attempted:
            self._attempted.add(key)
            with suppress(OSError):  # save_overload reports folders that cannot be written to
                self._impl.locator.ensure_cache_path()
            compile_lock.acquire(self._cache_file.lock(key))
            found = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
            if found is not None:
                compile_lock.release(self._cache_file.lock(key))
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store the machine code of a signature, or warn once if it cannot be written."""
        if self.cache_path is None:
            _warn_unkept("no folder for compiled kernels is writable")
            return
        try:
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]
        except OSError as error:  # full disk, quota, folder removed or write-protected meanwhile
            reason = error.strerror or str(error)
            _warn_unkept(f"compiled kernels cannot be written to {self.cache_path}: {reason}")
        finally:
            key = self._index_key(sig, data.codegen)  # type: ignore[no-untyped-call]
            compile_lock.release(self._cache_file.lock(key))

    def write_to(self, folder: Path) -> None:
        """Store all further machine code in a folder that will become :data:`INSTALLED`."""
        self._cache_file = self._installed = self._files_in(folder)

    def _files_in(self, folder: Path) -> _CacheFiles:
        package = self._py_func.__module__.rpartition(".")[0]
        name = f"{package}.{self._impl.filename_base}"
        return _CacheFiles(str(folder), name, self._stamp)  # type: ignore[no-untyped-call]


@cache  # once per process
def _limit_size(folder: Path) -> None:
    """Remove the files that were not used for the longest time from a folder of more than 1 GB."""
    states = []
    for file in folder.glob("*.nbc"):
        with suppress(FileNotFoundError):  # another process may do the same
            states.append((file.stat(), file))
    total = 0
    for state, file in sorted(states, key=lambda pair: pair[0].st_mtime, reverse=True):
        total += state.st_size
        if total > _MOST_BYTES:
            file.unlink(missing_ok=True)


def _keys_of_levels(key: Any) -> list[Any]:
    """Return the keys that a kernel has if it was compiled for a level of this processor, highest first."""
    signature, (triple, _, features), hashes = key  # numba's key, with its description of the processor
    return [(signature, (triple, level, ""), hashes) for level in supported_levels(features)]


_warned: set[str] = set()


def _warn_unkept(reason: str) -> None:
    """Log once per process that compiled kernels cannot be stored on disk."""
    if not _warned:
        _warned.add(reason)
        _log.warning(
            "%s; kernels are compiled again in each run. Set NUMBA_CACHE_DIR to a writable folder",
            reason,
        )


@cache  # assumes that sources do not change while a process runs
def source_stamp(file: Path) -> str:
    """Return a hash of a kernel's source files (:func:`sources`), the compiler module and numpy's version."""
    digest = sha256(np.__version__.encode() + _COMPILER.read_bytes())
    for source in sorted(sources(file), key=_place_in_package):
        digest.update(_place_in_package(source).encode())
        digest.update(source.read_bytes())
    return digest.hexdigest()


def sources(file: Path) -> set[Path]:
    """Find the source files on which the kernels in ``file`` depend.

    These are the file and its direct and indirect top-level imports from the core or from its own package.
    Some of these files may contain no kernels, which is harmless.
    """
    files: set[Path] = set()
    pending = {file} if file.is_file() else set()
    while pending:
        source = pending.pop()
        files.add(source)
        pending |= _imported_files(source) - files
    return files


def _package_of(source: Path) -> Path:
    """Return the folder of the outermost package that contains a file."""
    folder = source.parent
    while (folder.parent / "__init__.py").is_file():
        folder = folder.parent
    return folder


def _place_in_package(source: Path) -> str:
    """Return a file's path from its outermost package on, independent of the installation folder."""
    top = _package_of(source)
    return source.relative_to(top.parent if (top / "__init__.py").is_file() else top).as_posix()


@cache
def _imported_files(source: Path) -> frozenset[Path]:
    """Return the files of the core and the package of ``source`` that ``source`` imports from."""
    top = _package_of(source)
    files: set[Path] = set()
    for module, names in _import_statements(source):
        first = module.partition(".")[0]
        if first == _CORE.name:
            folder = _CORE.parent
        elif not (top / "__init__.py").is_file():  # a module that belongs to no package
            folder = top
        elif first == top.name:
            folder = top.parent
        else:  # another distribution: installed beside the package, or elsewhere
            continue
        files = files.union(*(_files_of(folder.joinpath(*module.split(".")), name) for name in names))
    return frozenset(files)


def _files_of(path: Path, name: str) -> set[Path]:
    """Return the source files that ``from module import name`` refers to.

    The file is a submodule, or the module and the origin of the name.
    """
    if (path / f"{name}.py").is_file():
        return {path / f"{name}.py"}
    if path == _CORE / "authoring":  # lazy module for plugins: resolve the name in its stub
        module, name = names_in_stub(path.with_suffix(".pyi")).get(name, (_CORE.name, name))
        return _files_of(_CORE.parent.joinpath(*module.split(".")), name)
    candidates = (path.with_suffix(".py"), path / "__init__.py")
    return {candidate for candidate in candidates if candidate.is_file()}


@cache
def _import_statements(source: Path) -> list[tuple[str, list[str]]]:
    """Return modules and names in the top-level ``from module import names`` statements of a file."""
    statements = _IMPORT.findall(source.read_text(encoding="utf-8"))
    return [(module, re.findall(r"(\w+)(?: as \w+)?", names)) for module, names in statements]
