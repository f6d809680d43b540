"""Temporary entries in PETSc's option database during the set-up of one solver.

The database is global to the program. User entries take precedence over agglo's defaults, and options for
one solver over both.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from types import TracebackType
from typing import Any, Self

from agglo_core.authoring import OptionError
from agglo_petsc.matrices import petsc


def parse_options(given: str | Mapping[str, Any]) -> dict[str, str]:
    """Parse options from a text like ``"-mg_levels_pc_type sor -ksp_view"`` or from a mapping.

    Names in a mapping may have a leading dash.

    Raises
    ------
    OptionError
        For a text that does not start with an option, or values other than texts, numbers or booleans.

    Examples
    --------
    >>> parse_options("-mg_levels_ksp_max_it 2 -ksp_view -pc_mg_distinct_smoothup")
    {'mg_levels_ksp_max_it': '2', 'ksp_view': '', 'pc_mg_distinct_smoothup': ''}
    >>> parse_options({"-ksp_rtol": 1e-3, "pc_mg_log": True})
    {'ksp_rtol': '0.001', 'pc_mg_log': 'true'}
    """
    if isinstance(given, Mapping):
        return dict(_pair(name, value) for name, value in given.items())
    if not isinstance(given, str):
        raise OptionError(f"petsc_options must be a string or a mapping, given {given!r:.60}")
    options: dict[str, str] = {}
    name = ""
    for word in shlex.split(given):
        if word[:1] == "-" and word[1:2].isalpha():
            name = word[1:]
            options[name] = ""
        elif name and not options[name]:
            options[name] = word
        else:
            raise OptionError(f"petsc_options: {word!r} is not a PETSc option; expected -name or -name value")
    return options


def _pair(name: Any, value: Any) -> tuple[str, str]:
    key = name.removeprefix("-") if isinstance(name, str) else ""
    if not key[:1].isalpha() or " " in key:
        raise OptionError(f"petsc_options: {name!r} is not the name of a PETSc option")
    if value is None:
        return key, ""
    if not isinstance(value, str | int | float):
        raise OptionError(
            f"petsc_options: {name} must be a string, a number or a boolean, given {value!r:.60}"
        )
    return key, str(value).lower() if isinstance(value, bool) else str(value)


class OptionDatabase:
    """Context in which PETSc's option database contains defaults and given options for one prefix.

    Parameters
    ----------
    prefix : str
        Solver prefix, including its last underscore.
    defaults, given : mapping of str to str
        Names without the prefix.
    """

    def __init__(self, prefix: str, defaults: Mapping[str, str], given: Mapping[str, str]) -> None:
        self._options, self._prefix = petsc().Options(prefix), prefix
        self._defaults, self._given = defaults, given
        self._before: dict[str, str | None] = {}

    def __enter__(self) -> Self:
        ours = {name: value for name, value in self._defaults.items() if not self._options.hasName(name)}
        for name, value in {**ours, **self._given}.items():
            self._before[name] = self._options.getString(name) if self._options.hasName(name) else None
            self._options.setValue(name, value)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for name, value in self._before.items():
            self._options.delValue(name)
            if value is not None:
                self._options.setValue(name, value)

    def unused(self) -> list[str]:
        """Return the names of the given options that PETSc has not used so far."""
        whole = petsc().Options()  # ``used`` takes no prefix
        return [name for name in self._given if not whole.used(f"{self._prefix}{name}")]

    def require_used(self) -> None:
        """Raise OptionError if PETSc has not used one of the given options."""
        unused = self.unused()
        if unused:
            names = ", ".join(f"-{name}" for name in unused)
            raise OptionError(
                f"petsc_options: nothing in this solver uses {names} (levels are -mg_levels_…, the coarsest "
                "is -mg_coarse_…, the iteration -ksp_…)"
            )
