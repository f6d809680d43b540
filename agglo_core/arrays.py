"""Array types, and conversion to the read-only C-contiguous arrays that dataclasses hold.

Read-only inputs also give every numba kernel a single signature: arguments are always read-only views,
outputs always new arrays.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agglo_core.errors import AggloError, MeshError

T = TypeVar("T")

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Index = NDArray[np.int32]
UInt64 = NDArray[np.uint64]
Bytes = NDArray[np.uint8]
Mask = NDArray[np.bool_]

_MIX = tuple(np.uint64(c) for c in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB))


def is_masked_array(values: Any) -> bool:
    """Return True for arrays of :mod:`numpy.ma`, without importing it."""
    return isinstance(values, _masked_type())


def _masked_type() -> tuple[type, ...]:
    masked = sys.modules.get("numpy.ma")  # already imported if such an array exists
    return () if masked is None else (masked.MaskedArray,)


def plain_array(values: Any, name: str = "array", error: type[AggloError] = MeshError) -> NDArray[Any]:
    """Convert values to a plain numpy array, without a change of dtype.

    Array subclasses become plain arrays.

    Raises
    ------
    AggloError
        Of the class ``error``, with the argument ``name``: for masked entries, which a plain array would
        replace by the hidden values, and for lists that form no array.
    """
    rows = values if isinstance(values, list | tuple) else (values,)
    types = set(map(type, rows))  # a list of numbers has one type, however long it is
    masked: Any = _masked_type()
    if any(issubclass(each, masked) for each in types) and any(
        isinstance(row, masked) and row.mask.any() for row in rows
    ):
        raise error(f"{name} has masked entries: fill them with .filled(value), or remove them")
    try:
        return np.asarray(values)
    except ValueError as reason:
        raise error(f"{name} must be an array of numbers: {reason}") from None


def exact_cast(
    array: NDArray[Any], dtype: Any, name: str = "array", error: type[AggloError] = MeshError
) -> NDArray[Any]:
    """Convert an array to ``dtype``, and raise an error for values that ``dtype`` cannot hold.

    Only floats may be rounded.

    Raises
    ------
    AggloError
        Of the class ``error``, with the argument ``name``: for numbers that ``dtype`` cannot hold, and for
        text, dates and complex numbers instead of numbers.
    """
    dtype = np.dtype(dtype)
    source, target = array.dtype.kind, dtype.kind
    # Trivial and safe casts.
    if array.dtype == dtype or not array.size:
        return array.astype(dtype, copy=False)
    if source in "biuf" and (target == "f" or np.can_cast(array.dtype, dtype)):
        return array.astype(dtype)
    # Reject non-numeric values, then compare the cast values with the originals.
    requirement = "numbers" if target == "f" else f"whole numbers that fit in {dtype}"
    texts = [value for value in array.flat if isinstance(value, str | bytes | None)] if source == "O" else []
    if source not in "biufO" or texts:
        raise error(f"{name} must be {requirement}, given {repr(texts[0]) if texts else array.dtype}")
    if source in "iu" and target in "iu":
        limits = np.iinfo(dtype)
        if limits.min <= array.min() and array.max() <= limits.max:
            return array.astype(dtype)
        error_mask = (array < limits.min) | (array > limits.max)
    else:
        try:
            with np.errstate(invalid="ignore", over="ignore"):
                cast = array.astype(dtype)
        except (TypeError, ValueError, OverflowError) as reason:
            raise error(f"{name} must be {requirement}: {reason}") from None
        if target == "f":
            return cast
        error_mask = cast != array
        if source == "f":  # 2^63 may become the largest int64, and both compare equal as floats
            error_mask |= np.abs(array) > 2.0**62
        if not error_mask.any():
            return cast
    place = np.argwhere(error_mask)[0].tolist()
    raise error(f"{name} must be {requirement}, given {array[tuple(place)]} at {place}")


def owned(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only array that no other code can modify: ``array`` itself, or a copy."""
    base: Any = array
    while isinstance(base, np.ndarray) and not base.flags.writeable:
        base = base.base
    return array if base is None or isinstance(base, bytes) else frozen(array.copy(), array.dtype)


def frozen(values: ArrayLike, dtype: Any) -> NDArray[Any]:
    """Return a read-only C-contiguous view of ``values`` in ``dtype`` (a copy only if necessary).

    Raises
    ------
    MeshError
        For masked entries, and values that ``dtype`` cannot hold; floats may be rounded.

    Examples
    --------
    >>> from agglo_core.authoring import frozen
    >>> values = frozen([1, 2], np.int16)
    >>> values, values.flags.writeable
    (array([1, 2], dtype=int16), False)
    """
    if type(values) is np.ndarray and values.dtype == dtype:  # usual case, mostly already frozen
        array = values if values.flags.c_contiguous else np.ascontiguousarray(values)
    else:
        array = exact_cast(plain_array(values), dtype)
        array = array if array.flags.c_contiguous else np.ascontiguousarray(array)
    if array.flags.writeable:
        array = array.view()
        array.flags.writeable = False
    return array


def frozen_float(values: ArrayLike) -> Float:
    """Return a read-only float64 array.

    Examples
    --------
    >>> from agglo_core.authoring import frozen_float
    >>> frozen_float([1, 2]).dtype.name
    'float64'
    """
    return frozen(values, np.float64)


def frozen_int(values: ArrayLike) -> Int:
    """Return a read-only int64 array (labels, offsets).

    Errors are those of :func:`frozen`, so fractions are rejected.

    Examples
    --------
    >>> from agglo_core.authoring import frozen_int
    >>> labels = frozen_int([0, 0, 1])
    >>> labels.dtype.name, labels.flags.writeable
    ('int64', False)
    """
    return frozen(values, np.int64)


def frozen_index(values: ArrayLike) -> Index:
    """Return a read-only int32 array (CSR indices).

    Errors are those of :func:`frozen`, so large numbers are rejected.

    Examples
    --------
    >>> from agglo_core.authoring import frozen_index
    >>> frozen_index([1, 2]).dtype.name
    'int32'
    """
    return frozen(values, np.int32)


def trusted(kind: type[T], /, *values: Any, **keywords: Any) -> T:
    """Create an instance of a frozen dataclass without the checks of its constructor.

    Arrays become read-only, and are neither copied nor cast. They must be consistent and have no other
    writers.
    """
    class_fields = fields(kind)  # type: ignore[arg-type]  # all of these classes are dataclasses
    field_values = dict(zip((field.name for field in class_fields), values, strict=False), **keywords)
    for field in class_fields:
        if field.default_factory is not MISSING:
            field_values.setdefault(field.name, field.default_factory())
        elif field.default is not MISSING:
            field_values.setdefault(field.name, field.default)
    instance = object.__new__(kind)
    instance.__dict__.update({field.name: _read_only(field_values.pop(field.name)) for field in class_fields})
    if field_values:
        raise TypeError(f"{kind.__name__} has no field {', '.join(field_values)}")
    return instance


def trusted_copy(original: T, /, **changes: Any) -> T:
    """Copy an instance of a frozen dataclass with some fields replaced, without checks.

    Arrays are treated as in :func:`trusted`.
    """
    names = [field.name for field in fields(original)]  # type: ignore[arg-type]
    return trusted(type(original), **({name: getattr(original, name) for name in names} | changes))


def _read_only(value: Any) -> Any:
    """Return an array, or a mapping of arrays, as read-only views. Other values are unchanged."""
    if isinstance(value, np.ndarray):
        return frozen(value, value.dtype)
    if isinstance(value, Mapping):
        return {key: _read_only(each) for key, each in value.items()}
    return value


class FieldState:
    """Base of frozen dataclasses whose pickles contain only the fields, no cached properties.

    Cached properties are not pickled, so that equal objects have equal pickles whatever was computed from
    them.
    """

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        self.__dict__.update(state)
        _forbid_writing(state)


def _forbid_writing(value: Any) -> None:
    """Make unpickled arrays read-only in place, because two fields may share an array."""
    if isinstance(value, np.ndarray):
        value.flags.writeable = False
    elif isinstance(value, Mapping | tuple | list):
        for each in value.values() if isinstance(value, Mapping) else value:
            _forbid_writing(each)


def label_order(labels: Int) -> Int:
    """Return the stable permutation ``(n,)`` that sorts non-negative labels, by radix sort.

    This is several times faster than argsort.
    """
    order = np.argsort((labels & 0xFFFF).astype(np.uint16), kind="stable")
    for shift in range(16, int(labels.max(initial=0)).bit_length(), 16):
        digits = (labels >> shift & 0xFFFF).astype(np.uint16)
        order = order[np.argsort(digits[order], kind="stable")]
    return frozen_int(order)


def index_cast(values: NDArray[Any], most: int) -> NDArray[Any]:
    """Copy a sparse matrix's index arrays, as int32 if the largest index ``most`` fits (scipy's rule)."""
    return values.astype(np.int32 if most <= np.iinfo(np.int32).max else np.int64)


def narrow(values: NDArray[Any]) -> NDArray[Any]:
    """Convert int64 arrays to int32 if all values fit.

    Other values are unchanged.
    """
    return values.astype(np.int32) if fits_in_index(values) else values


def fits_in_index(values: NDArray[Any]) -> bool:
    """Return True if the array is int64 and all its values fit in 32 bits."""
    if values.dtype != np.int64:
        return False
    limits = np.iinfo(np.int32)
    return bool(limits.min <= values.min(initial=0) and values.max(initial=0) <= limits.max)


def first_of_each(labels: Int) -> Int:
    """Return the index ``(k,)`` of the first occurrence of each label 0..k−1 (without gaps)."""
    first = np.empty(int(labels.max(initial=-1)) + 1, np.int64)
    first[labels[::-1]] = np.arange(len(labels))[::-1]  # the last assignment is the first occurrence
    return frozen_int(first)


def splitmix(seeds: UInt64) -> UInt64:
    """Hash integers by the splitmix64 mixing step: distinct inputs give distinct, well-spread outputs."""
    z = seeds + _MIX[0]
    z = (z ^ (z >> np.uint64(30))) * _MIX[1]
    z = (z ^ (z >> np.uint64(27))) * _MIX[2]
    return np.asarray(z ^ (z >> np.uint64(31)))
