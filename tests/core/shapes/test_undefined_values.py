"""Metrics that have no value on some agglomerates: counted by name, left out of means, never in silence."""

from __future__ import annotations

import json

import numpy as np
import pytest

import agglo_core as agglo
from agglo_core.cli.runs import level_data, show
from agglo_core.draw.plot import _title
from agglo_core.draw.webpage.payload import payload
from agglo_core.measure import Level, RunResult, measure_levels, summary


class OfLarge:
    """Number of cells, of parts of three cells and more."""

    better, bounds, homogeneity, undefined = "high", (3.0, float("inf")), 0, True

    def measure(self, mesh, labels):
        sizes = np.bincount(labels).astype(float)
        return np.where(sizes < 3, np.nan, sizes)


@pytest.fixture
def levels() -> list[Level]:
    mesh = agglo.samples.squares(4)
    hierarchy = agglo.agglomerate(mesh, n_parts=(16, 5))
    return measure_levels(mesh, hierarchy, metrics=[OfLarge(), "cells"])


def test_means_are_over_the_defined_values_and_the_others_are_counted(levels: list[Level]) -> None:
    everywhere, some = levels
    assert everywhere.line["OfLarge"] is None
    assert everywhere.line["undefined"] == {"OfLarge": 16}
    values = some.values["OfLarge"]
    count = int(np.isnan(values).sum())
    assert some.line["OfLarge"] == pytest.approx(np.nanmean(values))
    assert some.line.get("undefined", {}) == ({"OfLarge": count} if count else {})


def test_a_line_without_undefined_values_is_as_before() -> None:
    mesh = agglo.samples.squares(4)
    line = summary(mesh, agglo.agglomerate(mesh, n_parts=4))[0]
    assert "undefined" not in line


def test_tables_pictures_pages_and_json_count_undefined_values(
    levels: list[Level], capsys: pytest.CaptureFixture
) -> None:
    mesh = agglo.samples.squares(4)
    run = RunResult("inertial", agglo.agglomerate(mesh, n_parts=(16, 5)), levels)
    show("a table", [run])
    assert "– (16 undefined)" in capsys.readouterr().out
    assert "OfLarge – (16 undefined)" in _title(levels[0], usual=False)
    assert level_data(levels[0])["undefined"] == {"OfLarge": 16}
    page = payload(mesh, [run])
    assert page["runs"][0]["levels"][0]["undefined"] == {"OfLarge": 16}
    json.dumps(page, allow_nan=False)
