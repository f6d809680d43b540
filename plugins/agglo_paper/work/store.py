"""Computations as units of work, and a store for their results from which an interrupted run resumes."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from agglo_core.authoring import AggloError, staging

Data = dict[str, Any]
Results = Mapping[str, Data]
"""Results by unit key; a failed unit has ``{"error": reason}``."""

_PROJECTS: Final = (
    *("agglo", "numpy", "scipy", "numba"),
    *("scikit-learn", "pymetis", "torch", "networkx", "matplotlib"),
)
_SHARED: Final = ("grids.py", "strategies.py")  # modules that units use in addition to their own
_DECISIVE: Final = _PROJECTS[:-2]  # projects that affect the results


@dataclass(frozen=True, eq=False)
class Unit:
    """One computation: a function and its arguments, where arguments and result are plain data.

    Attributes
    ----------
    work : callable
        Called with ``settings`` as keywords.
    settings : mapping
    packages : tuple of str
        Packages whose code it runs, in addition to agglo_core and this plugin's module.
    """

    work: Callable[..., Data]
    settings: Mapping[str, Any]
    packages: tuple[str, ...] = ()

    @cached_property
    def key(self) -> str:
        """Identification of the computation: function and arguments in one line."""
        return json.dumps([self.work.__module__, self.work.__name__, self.settings], sort_keys=True)

    def run(self) -> Data:
        """Run the computation, and return its result or the error message of a failed component."""
        try:
            return self.work(**self.settings)
        except AggloError as error:
            cause: BaseException | None = error
            while cause is not None:  # Ctrl-C inside a component is not a failure
                if isinstance(cause, KeyboardInterrupt):
                    raise
                cause = cause.__cause__ or cause.__context__
            return {"error": str(error)}


@dataclass(frozen=True)
class Store:
    """A folder with one JSON result file per computation, valid for unchanged code and versions."""

    folder: Path

    def results(self, units: Iterable[Unit], done: Callable[[Unit, bool], None]) -> Results:
        """Return the results of all units: stored results, and otherwise newly computed ones.

        Parameters
        ----------
        units : iterable of Unit
        done : callable
            Called with each finished unit, and True if its result was stored.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.folder / ".gitignore").write_text("*\n", encoding="utf-8")
        data: dict[str, Data] = {}
        for unit in units:
            if unit.key not in data:
                data[unit.key], is_stored = self._result(unit)
                done(unit, is_stored)
        return data

    def _result(self, unit: Unit) -> tuple[Data, bool]:
        file = self.folder / f"{self._name(unit)}.json"
        try:
            stored: Data = json.loads(file.read_text(encoding="utf-8"))["result"]
        except (OSError, ValueError, KeyError, TypeError, RecursionError):  # missing or damaged
            stored = {}
        if stored:
            return stored, True
        result = unit.run()
        if "error" not in result:
            text = json.dumps({"unit": json.loads(unit.key), "result": result})
            with staging(file) as stage:
                (stage / file.name).write_text(text, encoding="utf-8")
            result = json.loads(text)["result"]
        return result, False

    @staticmethod
    def _name(unit: Unit) -> str:
        packages = sorted({"agglo_core", *unit.packages} - {""})
        code = [_package_digest(name) for name in packages]
        here = Path(unit.work.__code__.co_filename)
        own = [_file_digest(str(file)) for file in (here, *map(here.with_name, _SHARED))]
        decisive = {name: version for name, version in versions().items() if name in _DECISIVE}
        text = json.dumps([unit.key, code, own, decisive], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:32]


@cache
def versions() -> Mapping[str, str]:
    """Return the versions of Python and all relevant installed packages."""
    numbers = {"python": platform.python_version()}
    for project in _PROJECTS:
        try:
            numbers[project] = metadata.version(project)
        except metadata.PackageNotFoundError:
            continue
    return numbers


@cache
def _package_digest(name: str) -> str:
    """Return a hash of the source and weight files of a package, or of a single-file module."""
    spec = find_spec(name)
    if spec is None or spec.origin is None:
        return ""
    origin = Path(spec.origin)
    if origin.name != "__init__.py":
        return _file_digest(str(origin))
    files = sorted(f for f in origin.parent.rglob("*") if f.suffix in (".py", ".safetensors", ".npz"))
    return hashlib.sha256("".join(_file_digest(str(file)) for file in files).encode()).hexdigest()


@cache
def _file_digest(path: str) -> str:
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError:  # code without a file, as in an interactive session
        return ""
