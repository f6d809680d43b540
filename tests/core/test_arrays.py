"""Orders of labels."""

from __future__ import annotations

import numpy as np
import pytest

from agglo_core.arrays import frozen_int, label_order


@pytest.mark.parametrize("parts", [1, 7, 65_536, 65_537, 2**40])
def test_labels_are_ordered_as_a_stable_sort_does(parts: int) -> None:
    labels = frozen_int(np.random.default_rng(0).integers(0, parts, size=3000))
    np.testing.assert_array_equal(label_order(labels), np.argsort(labels, kind="stable"))
    assert len(label_order(labels[:0])) == 0
