"""``agglo plugins``: the listing, and one component with its options."""

from __future__ import annotations

import json

import pytest
from command_line import Agglo


def test_a_component_shows_its_options(agglo: Agglo) -> None:
    done = agglo("plugins", "metis")
    assert done.code == 0
    lines = [line.strip() for line in done.out.splitlines()]
    assert lines[0].startswith("bisector 'metis' (plugin 'metis', distribution agglo")
    assert "algorithm: 'kway' or 'recursive'; default 'kway'" in lines
    place = lines.index("ufactor: a whole number or none; default None")
    assert lines[place + 1].startswith("Allowed imbalance in thousandths")


def test_options_of_a_component_as_json(agglo: Agglo) -> None:
    done = agglo("plugins", "metric:diameter_ratio", "--json")
    (record,) = json.loads(done.out)
    (option,) = record["options"]
    assert (record["kind"], record["name"]) == ("metric", "diameter_ratio")
    assert (option["name"], option["type"], option["required"]) == ("h_star", "a number", True)


@pytest.mark.parametrize(
    ("name", "wanted"),
    [
        ("interface", "refiner 'interface'"),
        ("defaults/CR", "metric 'CR'"),
        ("command:paper", "command 'paper'"),
    ],
)
def test_names_may_say_kind_or_plugin(agglo: Agglo, name: str, wanted: str) -> None:
    assert agglo("plugins", name).out.startswith(wanted)


def test_a_plugin_shows_all_it_has(agglo: Agglo) -> None:
    out = agglo("plugins", "gnn").out
    assert "bisector 'gnn'" in out


def test_an_unknown_name_is_refused_with_the_list(agglo: Agglo) -> None:
    done = agglo("plugins", "nosuch")
    assert done.code == 2
    assert "no component, command or plugin is named 'nosuch'" in done.err
    assert "kmeans" in done.err
