"""Docstrings, comments and names keep the rules of CONTRIBUTING that a program can check."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from syntax import syntax_tree

ROOT = Path(__file__).parents[2]
FILES = sorted(file for top in ("agglo_core", "plugins") for file in (ROOT / top).rglob("*.py"))

RIDDLE = re.compile(r"(What|Whether|How|Where|Which|Who|The same)\b")
PERSON = re.compile(r"\b(told|tells?|says?|said|knows?|asks?|asked|wants?|somebody|nobody|anybody|but for)\b")
WORDS = 18


@cache
def trees() -> dict[str, ast.Module]:
    """Parse each file. Not at import: collecting the tests would take seconds in each worker."""
    return {file.relative_to(ROOT).as_posix(): syntax_tree(file) for file in FILES}


def docstrings() -> Iterator[tuple[str, str]]:
    """Yield place and docstring of each module, class and function."""
    for path, tree in trees().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                text = ast.get_docstring(node)
                if text is not None:
                    yield f"{path}:{getattr(node, 'lineno', 1)}", text


@cache
def headlines() -> dict[str, str]:
    return {place: " ".join(text.partition("\n\n")[0].split()) for place, text in docstrings()}


def prose() -> dict[str, str]:
    """Return the headlines without code."""
    return {place: re.sub("`+[^`]*`+", "", text) for place, text in headlines().items()}


def compiled_functions() -> Iterator[tuple[str, ast.FunctionDef]]:
    """Yield the kernels and helpers of each file."""
    for path, tree in trees().items():
        for node in tree.body:
            if isinstance(node, ast.FunctionDef):
                decorators = [ast.unparse(each).partition("(")[0] for each in node.decorator_list]
                if {"kernel", "helper"} & set(decorators):
                    yield path, node


def test_headlines_are_no_riddles() -> None:
    assert [f"{place} {text}" for place, text in headlines().items() if RIDDLE.match(text)] == []


def test_headlines_are_one_statement() -> None:
    assert [f"{place} {text}" for place, text in prose().items() if ";" in text] == []


def test_headlines_are_short() -> None:
    words = {place: re.findall(r"[^\W\d_]{2,}", text) for place, text in prose().items()}
    assert [f"{place} {' '.join(each)}" for place, each in words.items() if len(each) > WORDS] == []


def test_programs_are_no_persons() -> None:
    assert [f"{place} {text}" for place, text in prose().items() if PERSON.search(text)] == []


def test_two_of_five_headlines_begin_with_an_imperative() -> None:
    first = [text.split()[0] for text in headlines().values()]
    verbs = {"Return", "Compute", "Write", "Read", "Build", "Check", "Find", "Make", "Raise", "Yield"}
    assert sum(word in verbs for word in first) > 0.4 * len(first)


def test_long_compiled_functions_name_their_steps() -> None:
    bare = []
    for path, node in compiled_functions():
        lines = (ROOT / path).read_text(encoding="utf-8").splitlines()
        begin = node.body[0].end_lineno if ast.get_docstring(node) else node.lineno
        body = [line.strip() for line in lines[begin : node.end_lineno] if line.strip()]
        code = [line for line in body if not line.startswith("#")]
        comments = sum("#" in line for line in body)
        if len(code) > 25 and len(code) > 15 * comments:
            bare.append(f"{path}:{node.lineno} {node.name}: {comments} comments in {len(code)} lines")
    assert bare == []


def test_records_are_read_by_name() -> None:
    """Kernels use the fields of records, not places in tuples."""
    records = {"graph", "own", "shape", "units", "room", "state", "cells_of", "limits", "work"}
    places = [
        f"{path}:{each.lineno} {ast.unparse(each)}"
        for path, node in compiled_functions()
        for each in ast.walk(node)
        if isinstance(each, ast.Subscript)
        and isinstance(each.value, ast.Name)
        and each.value.id in records & {argument.arg for argument in node.args.args}
        and isinstance(each.slice, ast.Constant)
    ]
    assert places == []
