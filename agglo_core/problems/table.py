"""Numbers in TOML problem tables: a single number, or one for each tag value."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float
from agglo_core.errors import OptionError
from agglo_core.mesh import Mesh
from agglo_core.suggestions import did_you_mean

_LARGEST = sys.float_info.max
_Value = TypeVar("_Value")


def require_keys(table: Mapping[str, Any], keys: Sequence[str]) -> None:
    """Raise OptionError for unknown keys in a table. ``kind`` is always accepted."""
    unknown = sorted(set(table) - set(keys))
    if unknown:
        accepted = [*keys, "kind"]
        hint = did_you_mean(unknown[0], accepted)
        raise OptionError(f"unknown key {unknown[0]!r}{hint}; accepted: {', '.join(accepted)}")


def require_by_tag(name: str, data: Any, boundary: str, what: str) -> None:
    """Raise OptionError unless the data for boundary tags are a mapping. ``what`` names one of them."""
    if not isinstance(data, Mapping):
        raise OptionError(
            f"{name} must be a mapping from boundary tags to {what}; given {data!r:.60}: write "
            f"{name}={{0: {what}}} on a mesh without boundary tags, else one entry for each value of "
            f"mesh.face_tags[{boundary!r}]"
        )


def number(key: str, value: Any) -> float:
    """Return the value of a key as a finite float, or raise OptionError."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= _LARGEST:
        raise OptionError(f"{key} must be a finite number, given {value!r:.60}")
    return float(value)


def face_tag(key: str, name: Any, mesh: Mesh, always: str) -> str:
    """Return the name if it is a face tag of the mesh or ``always``, otherwise raise OptionError."""
    if name != always and (not isinstance(name, str) or name not in mesh.face_tags):
        raise OptionError(f"{key} must be a face tag of the mesh, given {name!r}; {_tags_of(mesh)}")
    return str(name)


def tensor_values(key: str, given: Any, mesh: Mesh) -> float | Float:
    """Return what :func:`cell_values` returns, or tensors if some values are matrices.

    A single matrix is returned as ``(d, d)``, a table as ``(n_cells, d, d)``. Numbers in a table with
    matrices are multiples of the identity.

    Raises
    ------
    OptionError
        As :func:`cell_values`, or for a matrix of another shape or a matrix that is not symmetric.
    """
    if isinstance(given, list):
        return frozen_float(_matrix(key, given, mesh.dim))
    if not isinstance(given, Mapping):
        return number(key, given)
    tables = {tag: values for tag, values in given.items() if isinstance(values, Mapping)}
    matrices: list[Float] = []

    def numbered(name: str, value: Any) -> Any:
        """Replace a matrix by its position in the list of matrices."""
        if isinstance(value, list):
            matrices.append(_matrix(f"{key}.{name}", value, mesh.dim))
        else:
            matrices.append(number(f"{key}.{name}", value) * np.eye(mesh.dim))
        return len(matrices) - 1

    if not any(isinstance(value, list) for values in tables.values() for value in values.values()):
        return cell_values(key, given, mesh)
    positions = {
        tag: {name: numbered(f"{tag}.{name}", value) for name, value in values.items()}
        for tag, values in tables.items()
    }
    cells = np.asarray(cell_values(key, positions, mesh), np.int64)
    return frozen_float(np.array(matrices)[cells])


def _matrix(key: str, given: Any, dim: int) -> Float:
    """Return a symmetric matrix ``(dim, dim)`` from nested lists."""
    rows = [row if isinstance(row, list) else [row] for row in given]
    if [len(row) for row in rows] != [dim] * dim:
        raise OptionError(f"{key} must be a number or {dim} rows of {dim} numbers, given {given!r:.60}")
    values = np.array([[number(key, value) for value in row] for row in rows])
    if not np.array_equal(values, values.T):
        raise OptionError(f"{key} must be symmetric, given {given!r:.60}")
    return values


def cell_values(key: str, given: Any, mesh: Mesh) -> float | Float:
    """Return a number, or values per cell ``(n_cells,)`` from a table of numbers for each tag value.

    Raises
    ------
    OptionError
        For an unknown tag, a missing or unknown tag value, or a value that is not a number.
    """
    if not isinstance(given, Mapping):
        return number(key, given)
    if len(given) != 1:
        raise OptionError(f"{key} must name one cell tag, given {', '.join(given) or 'none'}")
    ((tag, values),) = given.items()
    if tag not in mesh.cell_tags or not isinstance(values, Mapping):
        choices = ", ".join(mesh.cell_tags) or "none"
        raise OptionError(f"{key}.{tag} must be a table for a cell tag of the mesh; it has: {choices}")
    kinds = mesh.cell_kinds
    if tag not in kinds:
        raise OptionError(f"{key}.{tag}: the tag has too many values for a table on several ranks")
    by_value = _read_by_tag(f"{key}.{tag}", values, _values_by_name(kinds[tag], kinds), number)
    present = np.unique(kinds[tag])
    lacking = [int(tag_value) for tag_value in present if int(tag_value) not in by_value]
    if lacking:
        raise OptionError(f"{key}.{tag} has no number for {', '.join(map(str, lacking))}")
    foreign = sorted(set(by_value) - set(present.tolist()))
    if foreign:
        choices = ", ".join(map(str, present[:20]))
        raise OptionError(f"{key}.{tag} names {foreign[0]}; the tag's values in the mesh are: {choices}")
    numbers = np.array([by_value[int(tag_value)] for tag_value in present])
    return frozen_float(numbers[np.searchsorted(present, mesh.cell_tags[tag])])


def vector(key: str, value: Any, dim: int) -> Float:
    """Return the value of a key as a vector ``(dim,)`` of finite floats, or raise OptionError."""
    if not isinstance(value, list) or len(value) != dim:
        raise OptionError(f"{key} must be a list of {dim} numbers, given {value!r:.60}")
    return frozen_float([number(f"{key}[{axis}]", entry) for axis, entry in enumerate(value)])


def boundary_vectors(key: str, given: Any, mesh: Mesh, face_tag: str) -> dict[int, Float]:
    """Return the vector for each value of a face tag on the boundary, as :func:`boundary_values`."""
    return _by_boundary_tag(key, given, mesh, face_tag, lambda name, value: vector(name, value, mesh.dim))


def boundary_values(key: str, given: Any, mesh: Mesh, face_tag: str) -> dict[int, float]:
    """Return the number for each value of a face tag on the boundary.

    Without this tag, all faces have the value 0.

    A name may replace the value if a face tag with this name is 1 exactly on the value's faces, as for the
    patches and groups in files.

    Raises
    ------
    OptionError
        For a value without boundary faces, or an entry that is not a number.
    """
    return _by_boundary_tag(key, given, mesh, face_tag, number)


def _by_boundary_tag(
    key: str, given: Any, mesh: Mesh, face_tag: str, read: Callable[[str, Any], _Value]
) -> dict[int, _Value]:
    if not isinstance(given, Mapping):
        raise OptionError(
            f"{key} must be a table by boundary tag, given {given!r:.60}: below a line [{key}] write a "
            "number for each tag, such as 0 = 1.0"
        )
    kinds = mesh.boundary_kinds
    tags = kinds.tags.get(face_tag, np.zeros_like(kinds.component))
    present = np.unique(tags).tolist()
    values = _read_by_tag(key, given, _values_by_name(tags, kinds.tags), read)
    for tag in values:
        if tag not in present:
            choices = f"{', '.join(map(str, present))} ({_tags_of(mesh)})"
            raise OptionError(f"{key} names boundary tag {tag}; the mesh has: {choices}")
    return values


def robin_values(key: str, given: Any, mesh: Mesh, face_tag: str) -> dict[int, tuple[float, float]]:
    """Return α and g for each value of a face tag, from a table of ``alpha`` and ``value`` for each.

    Raises
    ------
    OptionError
        As :func:`boundary_values`, for another key, or a negative α.
    """
    if not isinstance(given, Mapping):
        raise OptionError(f"{key} must be a table by boundary tag, given {given!r:.60}")
    columns: dict[str, dict[str, float]] = {"alpha": {}, "value": {}}
    for tag, entry in given.items():
        if not isinstance(entry, Mapping) or set(entry) != set(columns):
            raise OptionError(f"{key}.{tag} must be a table with alpha and value, given {entry!r:.60}")
        for name, column in columns.items():
            column[tag] = number(f"{key}.{tag}.{name}", entry[name])
        if entry["alpha"] < 0.0:
            raise OptionError(f"{key}.{tag}.alpha must not be negative, given {entry['alpha']}")
    alpha, values = (boundary_values(key, column, mesh, face_tag) for column in columns.values())
    return {tag: (alpha[tag], values[tag]) for tag in alpha}


def _tags_of(mesh: Mesh) -> str:
    return f"it has the face tags: {', '.join(mesh.face_tags) or 'none'}"


def _values_by_name(values: Int, marks: Mapping[str, Int]) -> dict[str, int]:
    """Return the tag value for each name whose 0/1 tag marks exactly the entries of this value."""
    names: dict[str, int] = {}
    for name, marked in marks.items():
        inside = marked == 1
        found = np.unique(values[inside])
        if len(found) == 1 and ((values == found[0]) == inside).all():
            names[name] = int(found[0])
    return names


def _read_by_tag(
    key: str, table: Mapping[str, Any], names: Mapping[str, int], read: Callable[[str, Any], _Value]
) -> dict[int, _Value]:
    """Return the value for each tag value, from a table by tag value or name without repetitions."""
    values: dict[int, _Value] = {}
    for name, value in table.items():
        tag = names[name] if name in names else _tag_value(key, name, names)
        if tag in values:
            raise OptionError(f"{key} gives tag {tag} twice")
        values[tag] = read(f"{key}.{name}", value)
    return values


def _tag_value(key: str, name: str, names: Mapping[str, int]) -> int:
    try:
        return int(name)
    except ValueError:
        named = f" or one of its names: {', '.join(names)}" if names else ""
        raise OptionError(f"{key}: {name!r} must be a tag value (a whole number){named}") from None
