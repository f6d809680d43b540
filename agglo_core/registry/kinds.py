"""Component kinds: the methods, properties and laws of bisectors, refiners, solvers and others.

A new kind requires a new record here and a law file.

:mod:`agglo_core.protocols` defines each kind's behaviour. The records here contain the checks of the
registry at construction, each kind's laws, and the applicable promises.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final


@dataclass(frozen=True)
class Kind:
    """A kind of component, such as bisector or solver: required methods, possible promises, laws.

    Attributes
    ----------
    name : str
    summary : str
        Purpose of these components.
    methods : tuple of str
        Components have at least one of these methods, preferably the first; empty for functions.
    promises : tuple of str
        Promises that some law of the kind can check.
    laws : tuple of str
        Law files in ``agglo_core/conformance/laws`` for this kind.
    attributes : mapping of str to type
        Other necessary attributes.

    Examples
    --------
    >>> from agglo_core.registry import KINDS
    >>> KINDS["bisector"].methods
    ('bisect_level', 'bisect', 'partition')
    """

    name: str
    summary: str
    methods: tuple[str, ...]
    promises: tuple[str, ...]
    laws: tuple[str, ...]
    attributes: Mapping[str, type] = field(default_factory=dict)


_ON_GRAPHS = ("deterministic", "invariant", "3d", "pickles")
_ON_LEVELS = ("whole", "calls", "promises", "runs")
_OF_PARTS = ("general", "multigrid_parts", "whole", "calls", "promises")
_RECORDS = (
    Kind(
        "bisector",
        "splits a piece in two, or a graph into k parts",
        ("bisect_level", "bisect", "partition"),
        (*_ON_GRAPHS, "connected", "balanced", "kway"),
        ("general", "bisector", *_ON_LEVELS),
    ),
    Kind(
        "refiner",
        "moves cells between parts to improve an objective",
        ("refine",),
        _ON_GRAPHS,
        ("general", "parts", *_ON_LEVELS),
        {"objective": str},
    ),
    Kind(
        "fixer",
        "makes every part connected",
        ("fix",),
        _ON_GRAPHS,
        ("general", "parts", *_ON_LEVELS),
    ),
    Kind(
        "metric",
        "one number for each agglomerate",
        ("measure",),
        ("deterministic", "3d", "pickles"),
        ("general", "metric", *_ON_LEVELS),
    ),
    Kind(
        "solver",
        "solves a problem with multigrid on a hierarchy",
        ("solve",),
        ("deterministic", "3d", "pickles", "symmetric"),
        ("general", "solver", "known_solutions", *_ON_LEVELS),
    ),
    Kind(
        "format",
        "reads a mesh from a file, and optionally writes one",
        ("read",),
        ("3d", "pickles"),
        ("general", "file_format", "whole", "calls", "promises"),
        {"lossless": bool},
    ),
    Kind(
        "sample",
        "builds an example mesh",
        (),
        ("3d",),
        ("general", "sample_mesh", "whole", "calls", "promises", "runs"),
    ),
    Kind(
        "problem",
        "a problem for a solver, such as diffusion",
        ("from_table",),
        ("pickles",),
        ("general", "problem_kind", "whole", "calls", "promises"),
    ),
    Kind(
        "discretisation",
        "turns a problem on a mesh into a linear system, and its solution back into a function",
        ("assemble",),
        ("deterministic", "3d", "pickles", "patch_test"),
        ("general", "discretisation", "estimator", "known_solutions", "calls", "promises"),
        {"accepts": tuple},
    ),
    Kind(
        "estimator",
        "estimates the error of a solution in each cell",
        ("indicate",),
        ("deterministic", "3d", "pickles"),
        ("general", "estimator", "whole", "promises"),
        {"accepts": tuple},
    ),
    Kind(
        "smoother",
        "damps the rough part of the error on a multigrid level",
        ("setup",),
        ("deterministic", "pickles", "symmetric"),
        ("general", "whole", "smoother", "calls", "promises", "runs"),
    ),
    Kind(
        "transfer",
        "maps the unknowns of a coarse multigrid level to the next finer level",
        ("prolongation",),
        ("deterministic", "pickles"),
        _OF_PARTS,
    ),
    Kind(
        "coarse_operator",
        "builds the matrix of a coarse multigrid level",
        ("coarse_matrix",),
        ("deterministic", "pickles"),
        _OF_PARTS,
    ),
    Kind(
        "coarse_solver",
        "solves on the coarsest level of a multigrid method",
        ("solver_for",),
        ("deterministic", "pickles", "symmetric"),
        _OF_PARTS,
    ),
    Kind(
        "constraint",
        "forbids pairs of cells in a part, or restricts the cells of a part",
        ("forbidden", "admissible", "incomplete", "for_mesh"),
        ("3d", "pickles"),
        ("general", "constraint_masks", "whole", "calls", "promises"),
    ),
    Kind(
        "section",
        "a section of the report",
        ("html",),
        ("pickles",),
        ("general", "report_section", "whole", "calls", "promises"),
        {"title": str},
    ),
)
KINDS: Final[Mapping[str, Kind]] = MappingProxyType({record.name: record for record in _RECORDS})
"""All kinds by name, in the order of listings."""

PROMISES: Final = tuple(dict.fromkeys(promise for kind in _RECORDS for promise in kind.promises))
"""All promises that apply to some kind."""


def kind_of_methods(component: object) -> str | None:
    """Return the first kind for which the component has a required method, or None if there is none."""
    for kind in KINDS.values():
        if any(callable(getattr(component, method, None)) for method in kind.methods):
            return kind.name
    return None
