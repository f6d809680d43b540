"""The data of PLY files: rows of numbers of the types that the header names, with up to one list in each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Int, frozen_int
from agglo_core.errors import FileError
from agglo_core.files.text_numbers import reals
from agglo_core.io.text.counted_lists import counted_lists, record_starts

_NEEDED = ("vertex", "face")
_LONGEST = 1 << 30  # bytes of a record that can be


class Property(NamedTuple):
    """A number of each row, or a list of numbers."""

    name: str
    type: str  # of numpy, without the byte order
    counted: str = ""  # type of the length of a list, empty for a number


class Element(NamedTuple):
    """Rows of one kind."""

    name: str
    n: int
    properties: list[Property]


class Rows(NamedTuple):
    """What all rows of an element hold: numbers by name, and the list of each as CSR."""

    values: Mapping[str, NDArray[Any]]
    listed: str
    offsets: Int
    lists: Int


def read_elements(content: bytes, start: int, order: str, elements: list[Element]) -> dict[str, Rows]:
    """All elements up to the last of points and faces; ``order`` is the byte order, empty for text.

    Raises
    ------
    FileError
        For elements that are cut short, or have several lists.
    """
    last = max((i for i, each in enumerate(elements) if each.name in _NEEDED), default=-1)
    data = np.frombuffer(content, np.uint8, offset=start) if order else reals(content, start)
    found: dict[str, Rows] = {}
    for each in elements[: last + 1]:
        if not each.properties or sum(bool(p.counted) for p in each.properties) > 1:
            raise FileError(f"element {each.name!r} has no properties, or several lists in each row")
        try:
            found[each.name], used = (_binary if order else _text)(data, order, each)
        except FileError as error:
            raise FileError(f"element {each.name!r}: {error}") from None
        data = data[used:]
    if len(data) and last == len(elements) - 1:
        raise FileError(f"{len(data)} {'bytes' if order else 'numbers'} follow the last element")
    return found


def _split(element: Element) -> tuple[list[Property], list[Property], list[Property]]:
    """Properties before the list, the list, and those after it."""
    kinds = [bool(p.counted) for p in element.properties]
    place = kinds.index(True) if True in kinds else len(kinds)
    return element.properties[:place], element.properties[place : place + 1], element.properties[place + 1 :]


def _short(element: Element) -> FileError:
    return FileError(f"{element.n} are declared, the file ends before the last")


def _text(numbers: NDArray[Any], _: str, element: Element) -> tuple[Rows, int]:
    before, listed, after = _split(element)
    if not listed:
        used = element.n * len(before)
        if used > len(numbers):
            raise _short(element)
        table = numbers[:used].reshape(-1, len(before))
        return Rows(_typed(before, table), "", frozen_int([0]), frozen_int([])), used
    stream = np.where(np.abs(numbers) < 2**53, numbers, -1).astype(np.int64)
    stream[stream != numbers] = -1
    offsets, places, used = counted_lists(frozen_int(stream), element.n, len(before), len(after))
    width = len(before) + 1 + len(after)
    starts = offsets[:-1] + width * np.arange(element.n)
    values = _typed(before, numbers[starts[:, None] + np.arange(len(before))])
    ends = starts + width + np.diff(offsets)
    values |= _typed(after, numbers[ends[:, None] - np.arange(len(after), 0, -1)])
    return Rows(values, listed[0].name, offsets, frozen_int(stream[places])), used


def _typed(properties: list[Property], table: NDArray[Any]) -> dict[str, NDArray[Any]]:
    values: dict[str, NDArray[Any]] = {}
    for each, column in zip(properties, table.T, strict=True):
        whole = each.type[0] != "f"
        if whole and not ((np.abs(column) < 2**53) & (column == np.floor(column))).all():
            raise FileError(f"property {each.name!r} is not whole everywhere")
        values[each.name] = column.astype(np.int64) if whole else column
    return values


def _binary(data: NDArray[Any], order: str, element: Element) -> tuple[Rows, int]:
    before, listed, after = _split(element)
    head = np.dtype([(f"{i}", order + p.type) for i, p in enumerate(before)])
    tail = np.dtype([(f"{i}", order + p.type) for i, p in enumerate(after)])
    if not listed:
        used = element.n * head.itemsize
        if used > len(data):
            raise _short(element)
        table = data[:used].view(head)
        return Rows(_fields(before, table), "", frozen_int([0]), frozen_int([])), used
    length, item = (np.dtype(order + kind) for kind in (listed[0].counted, listed[0].type))
    if "f" in (length.kind, item.kind):
        raise FileError(f"the list {listed[0].name!r} is not one of whole numbers")
    fixed = head.itemsize + length.itemsize + tail.itemsize

    def ends(window: NDArray[Any]) -> Int:
        counts = _at(
            window, np.arange(max(len(window) - fixed + tail.itemsize + 1, 0)) + head.itemsize, length
        )
        stops = np.full(len(window), len(window) + 1)
        reach = np.arange(len(counts)) + fixed + counts * item.itemsize
        stops[: len(counts)] = np.where((counts > 0) & (counts < _LONGEST), reach, 1 << 60)
        return frozen_int(stops)

    starts, used = record_starts(data, element.n, ends)
    counts = _at(data, starts + head.itemsize, length)
    offsets = np.concatenate(([0], np.cumsum(counts)))
    first = starts + head.itemsize + length.itemsize
    places = np.repeat(first - item.itemsize * offsets[:-1], counts) + item.itemsize * np.arange(offsets[-1])
    values = _fields(before, _at(data, starts, head)) | _fields(
        after, _at(data, first + item.itemsize * counts, tail)
    )
    return Rows(values, listed[0].name, frozen_int(offsets), frozen_int(_at(data, places, item))), used


def _at(data: NDArray[Any], places: NDArray[Any], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Values of a type that begin at places of bytes, whole numbers as int64."""
    if not dtype.itemsize:
        return np.empty(len(places), dtype)
    found = data[places[:, None] + np.arange(dtype.itemsize)].view(dtype)[:, 0]
    return found.astype(np.int64) if dtype.kind in "iu" else found


def _fields(properties: list[Property], table: NDArray[Any]) -> dict[str, NDArray[Any]]:
    kept: dict[str, NDArray[Any]] = {}
    for i, each in enumerate(properties):
        kept[each.name] = table[f"{i}"].astype(np.float64 if each.type[0] == "f" else np.int64)
    return kept
