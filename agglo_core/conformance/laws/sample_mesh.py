"""Laws for a sample: the result is a sound mesh, and options are documented and matter."""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from typing import Any

from scipy.spatial import cKDTree

from agglo_core.conformance.base import Subject, in_words, law, require
from agglo_core.conformance.inputs.option_values import option_choices, option_values
from agglo_core.conformance.inputs.questions import digest
from agglo_core.errors import AggloError
from agglo_core.mesh import Mesh
from agglo_core.registry.options import options_of

_SIZES = (2, 3, 5, 9, 16, 25, 40)
_MANY = 3000  # cells; larger samples are not made
_FEW = 5  # some samples make equal meshes for n = 2 and 3


@law("sample")
def sample_is_mesh(subject: Subject) -> None:
    """The sample is a Mesh without cracks: no two faces of the boundary lie in the same place."""
    for options in option_choices(subject):
        mesh = _made(subject, options)
        if mesh is None:
            continue
        words = f"with the options {options}" if options else "without options"
        require(
            isinstance(mesh, Mesh),
            f"{words} it returned {in_words(mesh)}, expected a Mesh: Mesh.from_polygons(points, cells) "
            "makes one",
        )
        outer = mesh.face_centroids[mesh.face_cells[:, 1] < 0]
        pairs = cKDTree(outer).query_pairs(1e-9 * mesh.h)
        require(
            not pairs,
            f"{words}, {len(pairs)} pairs of boundary faces lie in the same place, for instance at "
            f"{outer[next(iter(pairs))[0]] if pairs else ''}: give each point one number",
        )


def _made(subject: Subject, options: Mapping[str, Any]) -> Any:
    """Return the sample with some options, or None if it refuses these values."""
    try:
        return subject.make(**options)
    except AggloError:
        if not options:
            raise
        return None


@law("sample")
def options_explained(subject: Subject) -> None:
    """Every option has an annotation, and is explained in the docstring or summary."""
    function = subject.target
    component = subject.record.component if subject.record else None
    whole = getattr(function, "func", function)  # of a functools.partial
    texts = [inspect.getdoc(whole), inspect.getdoc(type(function).__call__)]
    text = " ".join(filter(None, [*texts, component.summary if component else ""]))
    for option in options_of(function) or ():
        require(
            option.type is not inspect.Parameter.empty,
            f"option {option.name} has no readable annotation: with one such as {option.name}: int, agglo "
            "can check values from the command line",
        )
        require(
            re.search(rf"\b{option.name}\b", text),
            f"option {option.name} is not documented: describe it in the docstring",
        )


def _digest(mesh: Mesh) -> bytes:
    """Return a hash of a mesh except for its name, which may contain options."""
    return digest(replace(mesh, name="")).tobytes()


@law("sample")
def equal_options_equal_mesh(subject: Subject) -> None:
    """Two calls with equal options make equal meshes, also with 0 for a number."""
    numbers = [option.name for option in options_of(subject.target) or () if type(option.default) is int]
    for options in [*option_choices(subject), *({name: 0} for name in numbers)]:
        one, other = (_made(subject, options) for _ in range(2))
        require(
            one is None or _digest(one) == _digest(other),
            f"with the options {options} two calls made different meshes: pass the seed to "
            "np.random.default_rng, even if it is 0",
        )


def _options(subject: Subject) -> set[str]:
    return {option.name for option in options_of(subject.target) or ()}


@law("sample")
def options_matter(subject: Subject) -> None:
    """Each option changes the mesh, at least together with one value of another option."""
    for option in options_of(subject.target) or ():
        compared = 0
        for others in option_choices(subject, but=option.name):
            made = [_made(subject, others | {option.name: value}) for value in option_values(option)]
            meshes = [mesh for mesh in made if mesh is not None]
            compared += len(meshes) > 1
            if len({_digest(mesh) for mesh in meshes}) > 1:
                break
        else:
            require(
                not compared,
                f"all values of the option {option.name} give equal meshes: use it, and remember no mesh of "
                "other options",
            )


@law("sample", when=lambda subject: "n" in _options(subject))
def size_matters(subject: Subject) -> None:
    """With an option ``n``, larger n from 3 to 40 give more cells."""
    made = {}
    for n in _SIZES:
        with suppress(AggloError):  # some samples need a larger n
            made[n] = subject.make(n=n)
            if made[n].n_cells > _MANY:
                break
    counts = {n: mesh.n_cells for n, mesh in made.items()}
    require(
        len(counts) > 1 and all(counts[a] < counts[b] or b < _FEW for a, b in pairwise(counts)),
        f"the numbers of cells by n are {counts}: more are expected for larger n, or an OptionError",
    )


@law("sample", promise="3d")
def sample_in_space(subject: Subject) -> None:
    """The mesh is three-dimensional."""
    dim = subject.build().dim
    require(dim == 3, f"it promises 3d but made a mesh in {dim}-D: drop the promise")
