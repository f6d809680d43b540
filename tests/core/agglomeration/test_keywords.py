"""Signature and docstring of ``agglomerate``, and the command line, have the keywords of the one table."""

from __future__ import annotations

import inspect
import re

import agglo_core as agglo
from agglo_core.agglomeration.keywords import GROUPS, HELP, NAMES
from agglo_core.cli.app import app

PARAMETERS = list(inspect.signature(agglo.agglomerate).parameters)
DOCSTRING = inspect.getdoc(agglo.agglomerate) or ""


def test_the_signature_has_each_keyword_and_no_other() -> None:
    assert sorted(PARAMETERS) == sorted(["mesh", *NAMES, *GROUPS["Running"]])


def test_the_signature_is_in_the_order_of_the_groups() -> None:
    assert ["mesh", *(name for names in GROUPS.values() for name in names)] == PARAMETERS


def test_the_docstring_explains_each_parameter_in_this_order() -> None:
    explained = re.findall(r"^(\w+(?:, \w+)*) : ", DOCSTRING, re.MULTILINE)
    assert [name for names in explained for name in names.split(", ")] == PARAMETERS


def test_the_docstring_lists_the_groups() -> None:
    summary = DOCSTRING.partition("Parameters\n---")[0]
    listed = re.findall(r"^([A-Z][\w ]+)\n((?:    .+\n)+)", summary, re.MULTILINE)
    assert {title: tuple(" ".join(text.split()).split(", ")) for title, text in listed} == GROUPS


def test_the_command_line_has_an_option_for_each_with_its_help_text() -> None:
    helps = {each.name: getattr(each, "help", "") for each in app.commands["solve"].params}
    assert {name: helps.get(name) for name in NAMES} == HELP
