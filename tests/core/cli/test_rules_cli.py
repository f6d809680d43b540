"""Rules for parts on the command line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from command_line import Agglo

from agglo_core import samples, write

FINE = samples.squares(8)
LEFT = FINE.cell_centroids[:, 0] < 0.5
FAULT = (FINE.face_cells[:, 1] >= 0) & (LEFT[FINE.face_cells[:, 0]] != LEFT[FINE.face_cells[:, 1]])


def test_rules_on_the_command_line(agglo: Agglo, tmp_path):
    mesh = replace(FINE, cell_tags={"rock": LEFT.astype(int)}, face_tags={"fault": FAULT.astype(int)})
    path = tmp_path / "mesh.npz"
    write(path, mesh)
    rules = ("--regions", "rock", "--barriers", "fault", "--max-cells", "8", "--metric-tensor", "1,0,0,1")
    done = agglo("run", str(path), "--parts", "8", *rules, "--json")
    assert done.code == 0
    (level,) = done.data["runs"][0]["levels"]
    assert level["parts"] == 8
    refused = agglo("run", str(path), "--parts", "8", "--regions", "ore")
    assert refused.code == 2
    assert "no cell tag is named 'ore'; there are rock" in refused.err


def test_bounds_on_weights(agglo: Agglo, tmp_path):
    path = tmp_path / "mesh.npz"
    write(path, replace(FINE, cell_tags={"people": np.where(LEFT, 5, 1)}))
    words = ("run", str(path), "--cells-per-part", "1", "--weights", "people", "--min-weight", "20", "--json")
    done = agglo(*words)
    assert done.code == 0
    assert done.data["runs"][0]["statistics"]["small_parts"] == 0
    assert 1 < done.data["runs"][0]["levels"][0]["parts"] <= 9
    bounded = agglo("run", str(path), "--parts", "40", "--weights", "people", "--max-weight", "6", "--json")
    assert bounded.code == 0
    assert bounded.data["runs"][0]["levels"][0]["parts"] == 40
    refused = agglo("run", str(path), "--parts", "8", "--min-weight", "20")
    assert refused.code == 2
    assert "min_weight needs weights" in refused.err


def test_what_cannot_be_read_as_a_rule(agglo: Agglo):
    for words, message in (
        (("--metric-tensor", "1,2,3"), "is not a comma-separated list of 4 or 9 numbers"),
        (("--regions", "a,,b"), "is not a comma-separated list of tags"),
        (("--min-weight", "0"), "--min-weight"),
        (("--max-cells", "0"), "expected a whole number of at least 1"),
        (("--balance", "area"), "'cells', 'measure', 'weights'"),
        (("--boundary-rules", "corners"), "'ridges'"),
    ):
        refused = agglo("run", "squares:n=4", "--parts", "4", *words)
        assert refused.code == 2
        assert message in refused.err


def test_the_imbalance_is_in_the_data(agglo: Agglo):
    done = agglo("run", "voronoi:n=100", "--parts", "10", "--json")
    (told,) = done.data["runs"][0]["statistics"]["imbalance"]
    assert np.isclose(told * 10, round(told * 10))  # the largest number of cells over ten
