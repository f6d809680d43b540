"""Casts that lose nothing, arrays that nobody else can change, orders of labels."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from agglo_core import MeshError
from agglo_core.arrays import frozen_float, frozen_index, frozen_int, label_order, owned


@pytest.mark.parametrize("parts", [1, 7, 65_536, 65_537, 2**40])
def test_labels_are_ordered_as_a_stable_sort_does(parts: int) -> None:
    labels = frozen_int(np.random.default_rng(0).integers(0, parts, size=3000))
    np.testing.assert_array_equal(label_order(labels), np.argsort(labels, kind="stable"))
    assert len(label_order(labels[:0])) == 0


@pytest.mark.parametrize(
    ("cast", "values", "message"),
    [
        (frozen_int, [0.5], "given 0.5 at \\[0\\]"),
        (frozen_int, [[1.0, np.nan]], "given nan at \\[0, 1\\]"),
        (frozen_int, [np.inf], "given inf"),
        (frozen_int, [2.0**63], "whole numbers that fit in int64"),
        (frozen_int, np.array([2**63], np.uint64), "given 9223372036854775808 at"),
        (frozen_int, [2**70], "fit in int64"),
        (frozen_int, np.array([1.5], object), "given 1.5"),
        (frozen_int, ["1"], "given <U1"),
        (frozen_int, np.array(["1"], object), "given '1'"),
        (frozen_int, np.array(["2020-01-01"], "M8[D]"), "given datetime64"),
        (frozen_int, [1 + 0j], "given complex128"),
        (frozen_int, [[0, 1], [2]], "array of numbers"),
        (frozen_index, [2**31], "fit in int32, given 2147483648 at \\[0\\]"),
        (frozen_index, [0, -(2**31) - 1], "given -2147483649 at \\[1\\]"),
        (frozen_index, [2.0**31], "fit in int32"),
        (frozen_float, [1 + 1j], "numbers, given complex128"),
        (frozen_float, ["1.5"], "numbers, given <U3"),
        (frozen_float, np.array(["2020-01-01"], "M8[D]"), "numbers, given datetime64"),
        (frozen_float, np.array([None], object), "must be numbers, given None"),
        (frozen_float, np.ma.masked_greater([1.0, 2.0], 1.5), "masked"),
        (frozen_int, np.ma.masked_greater([1, 2], 1), "masked"),
        (frozen_int, [1, np.ma.masked], "masked"),
        (frozen_int, list(np.ma.masked_greater([[1, 2], [3, 4]], 3)), "masked"),
    ],
)
def test_what_a_cast_would_change_is_refused(cast: Any, values: Any, message: str) -> None:
    with pytest.raises(MeshError, match=message):
        cast(values)


@pytest.mark.parametrize(
    ("cast", "values", "expected"),
    [
        (frozen_int, [3.0, -2.0], [3, -2]),
        (frozen_int, np.array([2**31], np.uint64), [2**31]),
        (frozen_int, [], []),
        (frozen_int, np.array([7, 2**40], object), [7, 2**40]),
        (frozen_int, [True, False], [1, 0]),
        (frozen_index, np.array([2**31 - 1, -(2**31)]), [2**31 - 1, -(2**31)]),
        (frozen_index, np.arange(3, dtype=">i8"), [0, 1, 2]),
        (frozen_float, [2**53 + 1], [2.0**53]),  # floats are rounded
        (frozen_float, np.array([0.1], np.float32), [np.float32(0.1)]),
        (frozen_float, np.array([Fraction(1, 4)], object), [0.25]),
        (frozen_int, np.ma.array([1, 2], mask=[False, False]), [1, 2]),  # as netCDF readers return all arrays
    ],
)
def test_what_fits_is_cast(cast: Any, values: Any, expected: list[Any]) -> None:
    array = cast(values)
    assert array.tolist() == expected
    assert not array.flags.writeable
    assert type(array) is np.ndarray


def test_read_only_arrays_are_not_copied() -> None:
    values = np.arange(3)
    assert not np.shares_memory(owned(frozen_int(values)), values)  # a read-only view of a writable array
    values.flags.writeable = False
    assert np.shares_memory(owned(values[1:]), values)
