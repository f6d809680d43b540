"""Products with prolongations in blocks of one column, beside scipy's."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import sparse

from agglo_core.multigrid import Level


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("width", [3, 7])  # 7 is wider than any kernel with a constant width
def test_products_of_column_blocks(dtype: Any, width: int) -> None:
    rng = np.random.default_rng(width)
    n, m, each = 30, 11, 3
    columns = np.array([rng.choice(m, each, replace=False) for _ in range(n)]).ravel()
    pattern = columns, np.arange(0, n * each + 1, each)
    P = sparse.bsr_array((rng.random((n * each, width, 1)).astype(dtype), *pattern), shape=(n * width, m))
    level = Level(sparse.eye_array(n * width), np.arange(0, n * width + 1, width), P)
    x, y = rng.random(n * width).astype(dtype), rng.random(m).astype(dtype)
    before, rows = x.copy(), P.toarray()
    np.testing.assert_allclose(level.restricted(x), rows.T @ x, rtol=1e-5)
    np.testing.assert_allclose(level.prolonged(x, y), x + rows @ y, rtol=1e-5)
    assert np.array_equal(x, before)
    assert level.prolonged(x, y).dtype == level.restricted(x).dtype == dtype
    mixed = level.prolonged(x.astype(np.float64), y)  # a smoother may answer in another precision
    np.testing.assert_allclose(mixed, x + rows @ y, rtol=1e-5)
