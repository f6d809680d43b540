"""Laws for a sample: the result is a mesh, and options are documented."""

from __future__ import annotations

import inspect
import re

from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import require
from agglo_core.conformance.inputs.questions import in_words
from agglo_core.mesh import Mesh
from agglo_core.registry.options import options_of


@law("sample")
def sample_is_mesh(subject: Subject) -> None:
    """The sample is a Mesh."""
    mesh = subject.build()
    require(
        isinstance(mesh, Mesh),
        f"it returned {in_words(mesh)}, expected a Mesh: Mesh.from_polygons(points, cells) makes one",
    )


@law("sample")
def options_explained(subject: Subject) -> None:
    """Every option has an annotation, and is explained in the docstring or summary."""
    function = subject.target
    component = subject.record.component if subject.record else None
    text = f"{inspect.getdoc(function) or ''} {component.summary if component else ''}"
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


@law("sample", promise="3d")
def sample_in_space(subject: Subject) -> None:
    """The mesh is three-dimensional."""
    dim = subject.build().dim
    require(dim == 3, f"it promises 3d but made a mesh in {dim}-D: drop the promise")
