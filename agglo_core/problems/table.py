"""Values in TOML tables of problems: numbers, by cell tag and by boundary tag; errors name the key."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float
from agglo_core.errors import OptionError
from agglo_core.mesh import Mesh

_LARGEST = sys.float_info.max


def require_keys(table: Mapping[str, Any], keys: Sequence[str]) -> None:
    """Raise OptionError unless all keys of a table are known ones; ``kind`` is one in every file."""
    unknown = sorted(set(table) - set(keys))
    if unknown:
        raise OptionError(f"unknown key {unknown[0]!r}; accepted: {', '.join([*keys, 'kind'])}")


def number(key: str, value: Any) -> float:
    """A finite number, or OptionError."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= _LARGEST:
        raise OptionError(f"{key} must be a finite number, given {value!r:.60}")
    return float(value)


def face_tag(key: str, name: Any, mesh: Mesh, always: str) -> str:
    """The name of a face tag of the mesh, or ``always``; OptionError for any other."""
    if name != always and (not isinstance(name, str) or name not in mesh.face_tags):
        raise OptionError(f"{key} must be a face tag of the mesh, given {name!r}; {_tags_of(mesh)}")
    return str(name)


def cell_values(key: str, given: Any, mesh: Mesh) -> float | Float:
    """A number, or one for each cell ``(n_cells,)`` from a table by tag and value.

    Raises
    ------
    OptionError
        For a tag the mesh does not have, a value of the tag that is missing or unknown, or not a number.
    """
    if not isinstance(given, Mapping):
        return number(key, given)
    if len(given) != 1:
        raise OptionError(f"{key} must name one cell tag, given {', '.join(given) or 'none'}")
    ((tag, values),) = given.items()
    if tag not in mesh.cell_tags or not isinstance(values, Mapping):
        known = ", ".join(mesh.cell_tags) or "none"
        raise OptionError(f"{key}.{tag} must be a table by a cell tag of the mesh; it has: {known}")
    kinds = mesh.cell_kinds
    if tag not in kinds:
        raise OptionError(f"{key}.{tag}: the tag has too many values for a table on several ranks")
    by_value = _by_whole(f"{key}.{tag}", values, _named(kinds[tag], kinds))
    present = np.unique(kinds[tag])
    lacking = [int(each) for each in present if int(each) not in by_value]
    if lacking:
        raise OptionError(f"{key}.{tag} has no number for {', '.join(map(str, lacking))}")
    foreign = sorted(set(by_value) - set(present.tolist()))
    if foreign:
        known = ", ".join(map(str, present[:20]))
        raise OptionError(f"{key}.{tag} names {foreign[0]}; the tag's values in the mesh are: {known}")
    numbers = np.array([by_value[int(each)] for each in present])
    return frozen_float(numbers[np.searchsorted(present, mesh.cell_tags[tag])])


def boundary_values(key: str, given: Any, mesh: Mesh, face_tag: str) -> dict[int, float]:
    """Numbers by value of a face tag on the boundary; without that tag all faces have the value 0.

    Where another face tag marks the very faces of one value by 1, as the patches and groups of files do,
    its name may stand for the value.

    Raises
    ------
    OptionError
        For a value no boundary face has, or anything that is not a number.
    """
    if not isinstance(given, Mapping):
        raise OptionError(f"{key} must be a table by boundary tag, given {given!r:.60}")
    kinds = mesh.boundary_kinds
    tags = kinds.tags.get(face_tag, np.zeros_like(kinds.component))
    present = np.unique(tags).tolist()
    values = _by_whole(key, given, _named(tags, kinds.tags))
    for tag in values:
        if tag not in present:
            known = f"{', '.join(map(str, present))} ({_tags_of(mesh)})"
            raise OptionError(f"{key} names boundary tag {tag}; the mesh has: {known}")
    return values


def _tags_of(mesh: Mesh) -> str:
    return f"it has the face tags: {', '.join(mesh.face_tags) or 'none'}"


def _named(values: Int, marks: Mapping[str, Int]) -> dict[str, int]:
    """The value a name stands for: the tag of that name is 1 where ``values`` are that, and nowhere else."""
    names: dict[str, int] = {}
    for name, marked in marks.items():
        inside = marked == 1
        found = np.unique(values[inside])
        if len(found) == 1 and ((values == found[0]) == inside).all():
            names[name] = int(found[0])
    return names


def _by_whole(key: str, given: Mapping[str, Any], names: Mapping[str, int]) -> dict[int, float]:
    """Numbers by the value of a tag or by its name, each of which is written once."""
    values: dict[int, float] = {}
    for name, value in given.items():
        tag = names[name] if name in names else _whole(key, name, names)
        if tag in values:
            raise OptionError(f"{key} gives tag {tag} twice")
        values[tag] = number(f"{key}.{name}", value)
    return values


def _whole(key: str, name: str, names: Mapping[str, int]) -> int:
    try:
        return int(name)
    except ValueError:
        named = f", nor one of its names: {', '.join(names)}" if names else ""
        raise OptionError(f"{key}: {name!r} is not the value of a tag, a whole number{named}") from None
