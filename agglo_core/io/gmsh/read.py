"""Read Gmsh files of versions 2.x, 4.0 and 4.1, with named groups and integer element data."""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.errors import FileError
from agglo_core.io.gmsh.elements import (
    DIMS,
    VTK_TYPES,
    Elements,
    Entity,
    first_listings,
    read_elements,
    read_entities,
    read_nodes,
)
from agglo_core.io.gmsh.sections import Numbers, decode_name, gmsh_header, sections
from agglo_core.io.text.cell_lines import tags_declared
from agglo_core.io.to_mesh.soup import Soup
from agglo_core.mesh.elements import concatenate, gather

_log = logging.getLogger("agglo")
_NAME = re.compile(rb'[ \t]*(\d+)[ \t]+(-?\d+)[ \t]+"([^\n]*)"[ \t\r]*\n')
_VTK_WEDGE = 13
_WEDGE = (0, 2, 1, 3, 5, 4)  # VTK's order of the corners: Gmsh's first triangle looks inward
_SPARE, _EXPANSION = 1 << 26, 400  # bytes allowed for tags: fixed, and per byte of the file
_LARGEST = 1 << 53  # larger integers are not exact as doubles
_MISSING = -1  # value of elements without element data


class _Data(NamedTuple):
    """One ``$ElementData`` section: values of a named quantity on some elements."""

    name: str
    step: int
    numbers: Int  # of elements
    values: Float  # (n, components)


def soup_of_gmsh(content: bytes) -> tuple[Soup, set[str], list[str]]:
    """Return cells, tag names made from groups, and names of skipped element data.

    Each named physical group is a tag: 1 inside, 0 outside. ``gmsh:physical`` holds the first group of each
    element, ``gmsh:geometrical`` its entity, and ``gmsh:partition`` its partition, if any. Unnamed groups
    that are not the first group of all their elements become tags ``gmsh:physical_NUMBER``.

    Raises
    ------
    FileError
        For a broken file, another version, or unsupported elements.
    """
    # Locate the sections and check that the necessary sections exist.
    parts = [part for part in sections(content) if part[0] != "Comments"]
    places = {name: slice(start, stop) for name, start, stop in parts}
    if not parts or parts[0][0] != "MeshFormat":
        raise FileError("does not begin with $MeshFormat")
    for section in ("Nodes", "Elements"):
        if section not in places:
            hint = "; its nodes are parametric: save it with Mesh.SaveParametric = 0" * (
                "ParametricNodes" in places
            )
            raise FileError(f"has no ${section}{hint}")
    header = gmsh_header(content[places["MeshFormat"]], content[places["Nodes"]])
    # Parse the sections in file order.
    names: dict[str, list[tuple[int, int]]] = {}
    entities: dict[tuple[int, int], Entity] = {}
    data: list[_Data] = []
    for name, start, stop in parts[1:]:
        numbers = Numbers(name, content, start, stop, header)
        if name == "PhysicalNames":
            names = _group_names(content[start:stop])
        elif name in ("Entities", "PartitionedEntities"):
            entities |= read_entities(numbers)
        elif name == "Nodes":
            nodes = read_nodes(numbers)
        elif name == "Elements":
            elements = read_elements(numbers, entities)
        elif name == "ElementData":
            data.append(_element_data(numbers))
    declared = tags_declared(content[: places["Nodes"].start])
    if declared is not None and declared != len(data):
        raise FileError(f"{declared} $ElementData are declared, but {len(data)} follow: truncated")
    # Version 2 repeats elements per group: merge the repetitions into one cell.
    first = first_listings(elements) if header.version == "2" else frozen_int(np.arange(len(elements.types)))
    cell_elements = frozen_int(np.flatnonzero(first == np.arange(len(first))))
    cell = frozen_int(np.searchsorted(cell_elements, first))  # cell per element of the file
    members = np.column_stack((cell[elements.members[:, 0]], elements.members[:, 1]))
    # Bound the memory of the tags before they are built.
    steps = {block.name: block.step for block in data}
    if (4 + len(names) + len(steps)) * 8 * len(cell_elements) > _SPARE + _EXPANSION * len(content):
        raise FileError(
            f"tags for {len(names)} groups of {len(cell_elements)} elements are too large for the file size"
        )
    tags = {"gmsh:geometrical": frozen_int(elements.geometrical[cell_elements])}
    if elements.partition.any():
        tags["gmsh:partition"] = frozen_int(elements.partition[cell_elements])
    tags |= _data_tags(data, steps, elements, cell, len(cell_elements))
    of_groups, groups = _group_tags(DIMS[elements.types[cell_elements]], frozen_int(members), names)
    tags |= of_groups
    return _cells(elements, cell_elements, nodes, tags), groups, [name for name in steps if name not in tags]


def _group_names(body: bytes) -> dict[str, list[tuple[int, int]]]:
    """Map each name in ``$PhysicalNames`` to the groups (dimension, number) with that name."""
    names: dict[str, list[tuple[int, int]]] = {}
    for dim, number, name in _NAME.findall(body.partition(b"\n")[2]):
        names.setdefault(decode_name(name), []).append((int(dim), abs(int(number))))
    return names


def _group_tags(
    dims: Int, members: Int, names: Mapping[str, list[tuple[int, int]]]
) -> tuple[dict[str, Int], set[str]]:
    """Convert physical groups to cell tags, and return also the names of the 0/1 tags."""
    tags: dict[str, Int] = {}
    cells, numbers = members.T
    physical = np.zeros(len(dims), np.int64)
    physical[cells[::-1]] = numbers[::-1]  # the first group is kept
    if len(members):
        tags["gmsh:physical"] = frozen_int(physical)
    # Membership of each name: equal number and dimension.
    has_name = np.zeros(len(members), bool)
    groups = {}
    for name, pairs in names.items():
        inside = np.zeros(len(members), bool)
        for dim, number in pairs:
            inside |= (numbers == number) & (dims[cells] == dim)
        has_name |= inside
        groups[name] = inside
    # Unnamed groups that ``gmsh:physical`` does not show.
    extra_numbers = np.unique(numbers[~has_name & (physical[cells] != numbers)])
    groups |= {
        f"gmsh:physical_{number}": ~has_name & (numbers == number) for number in extra_numbers.tolist()
    }
    for name, inside in groups.items():
        tag = np.zeros(len(dims), np.int64)
        tag[cells[inside]] = 1
        tags[name] = frozen_int(tag)
    return tags, set(groups)


def _element_data(numbers: Numbers) -> _Data:
    titles = [numbers.line().strip(b'"') for _ in range(numbers.line_count())]
    for _ in range(numbers.line_count()):
        numbers.line()  # the time
    counts = [numbers.line_count() for _ in range(numbers.line_count())]
    if not titles or len(counts) < 3:
        raise FileError("$ElementData lacks its name or its numbers of components and values")
    number, values = numbers.rows(counts[2], counts[1])
    return _Data(decode_name(titles[0]), counts[0], number, values)


def _data_tags(
    data: list[_Data], steps: Mapping[str, int], elements: Elements, cell: Int, n: int
) -> dict[str, Int]:
    """Convert integer element data with one component to cell tags ``(n,)``.

    Missing values are −1.
    """
    tags = {}
    dims = DIMS[elements.types]
    top = np.unique(cell[dims == dims.max(initial=0)])
    for name, step in steps.items():
        # Only the last time step is kept.
        blocks = [block for block in data if block.name == name]
        if any(block.step != step for block in blocks):
            _log.warning("element data %r: only the last time step, %d, is read", name, step)
        last = [block for block in blocks if block.step == step]
        values = np.concatenate([block.values.ravel() for block in last])
        whole = all(block.values.shape[1] == 1 for block in last) and (np.abs(values) < _LARGEST).all()
        if not whole or (values != np.floor(values)).any():
            continue
        # Map element numbers to cells and fill the tag.
        place = _places(elements.numbers, frozen_int(np.concatenate([block.numbers for block in last])))
        tag, covered = np.full(n, _MISSING), np.zeros(n, bool)
        target = cell[place[place >= 0]]
        tag[target], covered[target] = values[place >= 0].astype(np.int64), True
        lacking, unknown = int((~covered[top]).sum()), int((place < 0).sum())
        if lacking:
            _log.warning("element data %r: %d of %d cells have no value and get −1", name, lacking, len(top))
        if unknown:
            _log.warning(
                "element data %r: %d values belong to elements that are not in the file", name, unknown
            )
        tags[name] = frozen_int(tag)
    return tags


def _cells(elements: Elements, cell_elements: Int, nodes: tuple[Int, Float], tags: Mapping[str, Int]) -> Soup:
    """Convert the elements that become cells to VTK types and VTK's node order."""
    offsets, entries = gather(elements.offsets, cell_elements)
    numbers = elements.nodes[entries]
    vertices = np.array(_places(nodes[0], frozen_int(numbers)))
    if vertices.min(initial=0) < 0:
        raise FileError(f"an element uses node {numbers[np.argmin(vertices)]}, which the file does not list")
    types = VTK_TYPES[elements.types[cell_elements]]
    wedges = offsets[:-1][types == _VTK_WEDGE][:, None] + np.arange(6)
    vertices[wedges] = vertices[wedges[:, _WEDGE]]
    return Soup(nodes[1], frozen_int(types), offsets, frozen_int(vertices), concatenate([]), tags)


def _places(numbers: Int, queries: Int) -> Int:
    """Return the index of each of ``queries`` in ``numbers``, or −1 if absent."""
    if not len(numbers):
        return frozen_int(np.full(len(queries), -1))
    order = np.argsort(numbers, kind="stable")
    positions = order[np.minimum(np.searchsorted(numbers, queries, sorter=order), len(numbers) - 1)]
    return frozen_int(np.where(numbers[positions] == queries, positions, -1))
