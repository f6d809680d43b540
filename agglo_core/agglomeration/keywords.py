"""Keywords of an agglomeration run: name, default, role and help text of each.

Besides the signature and docstring of :func:`~agglo_core.agglomeration.one_call.agglomerate`, which a test
compares with this table, there is no other keyword list. Pipelines, TOML files and the command line take
names, defaults and help texts from here. This module imports no numerical package, so that the command-line
help starts fast.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, fields
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

Choice: TypeAlias = str | tuple[str, Mapping[str, Any]] | Any
"""A component: its name, its name with options, or an object with a method of its kind."""
Numbers: TypeAlias = float | Sequence[float]
Method = Literal["recursive", "kway"]
Balance = Literal["cells", "measure", "weights"]
Names: TypeAlias = str | Sequence[str]
Marks: TypeAlias = "Names | Mapping[str, Any] | ArrayLike"
"""Tags, tags with the values that count, or an array."""

METHODS = ("recursive", "kway")
BALANCES = ("cells", "measure", "weights")
POLISH = ("compactness",)
"""Default refiners of finished levels. If a registry has no refiner of this name, the built-in refiner is
used."""

Role = Literal["step", "size", "count", "constraint", "rule", "bound"]


def _about(text: str, role: Role = "step", *, component: str = "") -> dict[str, str]:
    """Return the metadata for a keyword: help text, role and component kind."""
    return {"help": text, "role": role, "component": component}


@dataclass(frozen=True)
class Keywords:
    """Keywords of an agglomeration run, described in :func:`~agglo_core.agglomerate`."""

    bisector: Choice = field(
        default="kmeans", metadata=_about("How a piece is split (default kmeans).", component="bisector")
    )
    refiners: Sequence[Choice] = field(
        default=("interface",), metadata=_about("Repeatable; 'none' for none.", component="refiner")
    )
    fixer: Choice = field(default="connectivity", metadata=_about("Default connectivity.", component="fixer"))
    method: Method = field(default="recursive", metadata=_about("Default recursive."))
    nested: bool = field(default=True, metadata=_about("Each level coarsens the finer one (default)."))
    merge: bool = field(
        default=False, metadata=_about("For sizes: merge neighbours while the union meets the target.")
    )
    polish: bool = field(default=True, metadata=_about("Polish finished levels (default)."))
    post_refiners: Sequence[Choice] = field(
        default=POLISH,
        metadata=_about(
            "For each finished level (default compactness). Repeatable; 'none' for none.", component="refiner"
        ),
    )
    seed: int = field(default=0, metadata=_about("Default 0."))
    h_star: Numbers | None = field(default=None, metadata=_about("Largest diameters, one per level.", "size"))
    h_factor: Numbers | None = field(
        default=None, metadata=_about("Largest diameters divided by h0.", "size")
    )
    n_parts: Numbers | None = field(
        default=None, metadata=_about("Numbers of agglomerates, one per level.", "count")
    )
    cells_per_part: Numbers | None = field(
        default=None,
        metadata=_about("Mean numbers of cells per agglomerate (default 8,64,… to about 12 parts).", "count"),
    )
    _: KW_ONLY
    constraints: Sequence[Choice] = field(
        default=(),
        metadata=_about("A rule for the parts. Repeatable.", "constraint", component="constraint"),
    )
    regions: Names | ArrayLike | None = field(
        default=None,
        metadata=_about("No part contains cells of two regions (cell tags), such as materials.", "rule"),
    )
    barriers: Marks | None = field(
        default=None,
        metadata=_about("No part lies on both sides of faces with a tag, such as fractures.", "rule"),
    )
    where: Marks | None = field(
        default=None, metadata=_about("Agglomerate only cells with a tag; all others stay single.", "rule")
    )
    boundary_rules: Literal["ridges"] | None = field(
        default=None,
        metadata=_about("Join cells only with those on the same boundary patches (face tags).", "rule"),
    )
    weights: str | ArrayLike | None = field(
        default=None, metadata=_about("Cell data by which counts are balanced, or that is bounded.", "rule")
    )
    balance: Balance | None = field(
        default=None, metadata=_about("Quantity that counts divide evenly (default cells).", "rule")
    )
    max_cells: int | None = field(
        default=None, metadata=_about("Largest number of cells in a part.", "bound")
    )
    min_cells: int | None = field(
        default=None, metadata=_about("Parts with fewer cells join a neighbour.", "bound")
    )
    max_measure: float | None = field(
        default=None, metadata=_about("Largest measure of a part, except for single cells.", "bound")
    )
    max_weight: float | None = field(
        default=None, metadata=_about("Largest weight of a part, except for single cells.", "bound")
    )
    min_measure: float | None = field(
        default=None, metadata=_about("Smaller parts join a neighbour.", "bound")
    )
    min_weight: float | None = field(
        default=None, metadata=_about("Lighter parts join a neighbour.", "bound")
    )
    metric: ArrayLike | None = field(
        default=None, metadata=_about("Tensor that defines lengths, row by row: 1,0,0,100.", "rule")
    )
    lines: bool = field(
        default=False, metadata=_about("Keep lines of strongly coupled cells together.", "rule")
    )


def _names(*roles: Role) -> tuple[str, ...]:
    return tuple(each.name for each in fields(Keywords) if each.metadata["role"] in roles)


NAMES = tuple(each.name for each in fields(Keywords))
HELP: Mapping[str, str] = {each.name: each.metadata["help"] for each in fields(Keywords)}
COMPONENTS: Mapping[str, str] = {
    each.name: each.metadata["component"] for each in fields(Keywords) if each.metadata["component"]
}
"""Component kind of each keyword that selects components."""
COMPONENT_LISTS = tuple(name for name in COMPONENTS if isinstance(getattr(Keywords, name), tuple))
SIZES, COUNTS = _names("size"), _names("count")
TARGETS = (*SIZES, *COUNTS)
"""Kinds of target. A run has exactly one target."""
BOUNDS = _names("bound")
RULES = _names("rule", "bound")
"""Keywords of the rules for parts."""
GROUPS: Mapping[str, Sequence[str]] = {
    "Targets": TARGETS,
    "Method": _names("step"),
    "Rules for parts": _names("constraint", "rule", "bound"),
    "Running": ("config", "allow_code", "registry", "progress", "verbose", "threads"),
}
"""All parameters of ``agglomerate`` except the mesh, in the order of its signature, and by group for help
texts."""
