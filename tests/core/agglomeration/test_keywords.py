"""Signature and docstring of ``agglomerate``, and the command line, have the keywords of the one table."""

from __future__ import annotations

import inspect
import re

import agglo_core as agglo
from agglo_core.agglomeration.keywords import HELP, NAMES
from agglo_core.cli.app import app

PARAMETERS = list(inspect.signature(agglo.agglomerate).parameters)
RUNNING = ["mesh", "config", "registry", "allow_code", "progress", "verbose", "threads"]
"""Parameters that say how a run is made, not what it makes."""


def test_the_signature_has_each_keyword_and_no_other() -> None:
    assert sorted(PARAMETERS) == sorted([*NAMES, *RUNNING])


def test_the_docstring_explains_each_parameter() -> None:
    text = inspect.getdoc(agglo.agglomerate) or ""
    explained = re.findall(r"^(\w+(?:, \w+)*) : ", text, re.MULTILINE)
    assert sorted(name for names in explained for name in names.split(", ")) == sorted(PARAMETERS)


def test_the_command_line_has_an_option_for_each_with_its_help_text() -> None:
    helps = {each.name: getattr(each, "help", "") for each in app.commands["solve"].params}
    assert {name: helps.get(name) for name in NAMES} == HELP
