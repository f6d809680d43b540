"""Records of declared components and commands: origin, state, and the reason for the state."""

from __future__ import annotations

import re
import sys
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import metadata
from importlib.util import find_spec
from typing import Literal

from agglo_core.registry.declarations import CORE_COMMANDS, Command, Component

State = Literal["ok", "needs", "broken", "conflict", "blocked"]

_PROJECTS = {"sklearn": "scikit-learn"}  # import names that differ from their pip names


@dataclass(frozen=True)
class Record:
    """A declared component or command, with its origin and state (usable, broken, …).

    A failed plugin has neither.

    Attributes
    ----------
    component : Component or None
    plugin, distribution, version : str
        Entry-point name and its distribution; the last two are empty if registered by hand.
    state : str
        ``ok``, ``needs`` (packages, listed in ``missing``), ``broken``, ``conflict`` or ``blocked``.
    reason : str
        Reason for a state other than ok.
    import_seconds : float
        Import time of the plugin's declaration.

    Examples
    --------
    >>> from agglo_core.registry import default
    >>> record = next(record for record in default().list() if record.name == "sweep")
    >>> record.kind, record.state, record.component.promises["deterministic"]
    ('bisector', 'ok', True)
    """

    component: Component | None
    plugin: str
    distribution: str = ""
    version: str = ""
    state: State = "ok"
    reason: str = ""
    missing: tuple[str, ...] = ()
    command: Command | None = None
    import_seconds: float = field(default=0.0, compare=False)

    @property
    def kind(self) -> str:
        """Component kind, ``"command"``, or ``"plugin"`` for a failed plugin."""
        if self.component is not None:
            return self.component.kind
        return "plugin" if self.command is None else "command"

    @property
    def name(self) -> str:
        """Name of the component, command or failed plugin."""
        declared = self.component or self.command
        return self.plugin if declared is None else declared.name

    @property
    def in_tree(self) -> bool:
        """True for components of the ``agglo`` distribution itself, whose names are reserved."""
        return re.sub(r"[-_.]+", "-", self.distribution).lower() == "agglo"

    @cached_property
    def title(self) -> str:
        """Name and origin for messages, see :func:`describe`."""
        origin = f"distribution {self.distribution} {self.version}".strip()
        if not self.distribution:
            origin = "registered by hand"
        if self.kind == "plugin":
            return f"plugin {self.plugin!r} ({origin})"
        return f"{self.kind} {self.name!r} (plugin {self.plugin!r}, {origin})"

    @property
    def declared(self) -> bool:
        """True for a component or command that is usable, or lacks only packages."""
        return self.kind != "plugin" and self.state in ("ok", "needs")


def describe(record: Record) -> str:
    """Return the name and origin of a component or command, as printed in messages.

    An example is ``bisector 'halves' (plugin 'halves', distribution my-dist 0.3)``.

    Examples
    --------
    >>> from agglo_core.registry import default, describe
    >>> (record,) = (record for record in default().list() if record.name == "balance")
    >>> describe(record)
    "refiner 'balance' (plugin 'defaults', distribution agglo ...)"
    """
    return record.title


def unusable(record: Record) -> str:
    """Return the state of a component that cannot be used, with the reason.

    If packages are missing, the reason begins with the state.
    """
    return record.reason if record.state == "needs" else f"{record.state}: {record.reason}"


class Installed:
    """Modules and extras that are installed, looked up once per listing.

    Packages may be added between two listings.
    """

    def __init__(self) -> None:
        self._modules: dict[str, bool] = {}
        self._extras: dict[str, dict[str, set[str]]] = {}

    def importable(self, name: str) -> bool:
        """Return True if a module is installed, without an import."""
        top = name.partition(".")[0]  # find_spec would import the package of a submodule
        if top not in self._modules:
            self._modules[top] = _is_importable(top)
        return self._modules[top]

    def extras(self, distribution: str) -> dict[str, set[str]]:
        """Return a distribution's packages in each extra (optional dependency group), in metadata order.

        The result is empty for an unknown distribution.
        """
        if distribution not in self._extras:
            self._extras[distribution] = _extras(distribution)
        return self._extras[distribution]


def with_requirements(record: Record, installed: Installed) -> Record:
    """Return the record, in state ``needs`` if a required module is not installed."""
    if record.component is None or record.state != "ok":
        return record
    missing = tuple(name for name in record.component.requires if not installed.importable(name))
    if not missing:
        return record
    remedy = _remedy(record, missing, installed)
    reason = f"needs {', '.join(missing)}, not installed here; try: {remedy}"
    return replace(record, state="needs", reason=reason, missing=missing)


def _is_importable(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except (ImportError, ValueError):
        return sys.modules.get(module) is not None


def _remedy(record: Record, missing: Sequence[str], installed: Installed) -> str:
    """Return the ``pip install`` command that supplies a component's missing packages.

    It names the plugin's own extra, else another sufficient extra, else the packages.
    """
    projects = {_PROJECTS.get(name, name) for name in missing}
    extras = installed.extras(record.distribution)
    plugin_extra = extras.get(record.plugin)
    bringing = [extra for extra, names in extras.items() if projects <= names]
    if plugin_extra is not None and (not plugin_extra or record.plugin in bringing):
        return f"pip install '{record.distribution}[{record.plugin}]'"
    if bringing:
        smallest = min(bringing, key=lambda extra: len(extras[extra]))
        return f"pip install '{record.distribution}[{smallest}]'"
    return f"pip install {' '.join(sorted(projects))}"


def _extras(distribution: str) -> dict[str, set[str]]:
    try:
        lines = metadata.metadata(distribution)
    except (metadata.PackageNotFoundError, ValueError):
        return {}
    extras: dict[str, set[str]] = {name: set() for name in lines.get_all("Provides-Extra") or []}
    for line in lines.get_all("Requires-Dist") or []:
        match = re.match(r"([\w.-]+).*;.*extra == ['\"]([\w.-]+)['\"]", line)
        if match and match[2] in extras:
            extras[match[2]].add(re.sub(r"[-_.]+", "-", match[1]).lower())
    return extras


def with_conflicts(records: Sequence[Record]) -> list[Record]:
    """Return the records, in state ``conflict`` where several declare the same name."""
    rivals: dict[tuple[str, str], list[Record]] = defaultdict(list)
    for record in records:
        if record.declared:
            rivals[record.kind, record.name].append(record)
    return [_resolve_conflict(r, rivals[r.kind, r.name]) if r.declared else r for r in records]


def _resolve_conflict(record: Record, rivals: list[Record]) -> Record:
    """Return the record, in state ``conflict`` if its name belongs to another or is declared twice.

    Built-in components keep their names. Equal names of plugins are in conflict.
    """
    if len(rivals) == 1 and record.command is None:
        return record
    owners = [rival for rival in rivals if rival.in_tree] or rivals
    if record.command is not None and not record.in_tree and record.name in CORE_COMMANDS:
        reason = "the name is reserved for a built-in command of agglo"
    elif owners == [record]:
        return record
    elif record in owners:
        rival_names = ", ".join(describe(owner) for owner in owners if owner is not record)
        reason = f"the name is also declared by {rival_names}"
    else:
        reason = f"the name is reserved for {describe(owners[0])}"
    same_plugin = [rival for rival in rivals if rival.plugin == record.plugin]
    qualifier = record.plugin if len(same_plugin) == 1 else record.distribution
    return replace(record, state="conflict", reason=f"{reason}; use '{qualifier}/{record.name}'")
