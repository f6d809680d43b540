"""Meshes to try things on, each by a function and by a short text such as ``voronoi:n=5000,seed=3``.

>>> from agglo_core import samples
>>> samples.squares(4)
Mesh('squares 4x4', 2-D, 16 cells, 40 faces, 25 points)
>>> samples.from_spec("paper:triangles").n_cells
128
"""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Callable
from types import MappingProxyType

from agglo_core.errors import OptionError
from agglo_core.mesh import Mesh
from agglo_core.samples.brain_section import brain, brain_holes
from agglo_core.samples.clouds import random_triangles, voronoi
from agglo_core.samples.paper_grids import paper
from agglo_core.samples.regular import disconnected, hexagons, ring, squares, strip, triangles
from agglo_core.samples.solids import boxes, tetrahedra

__all__ = [
    "boxes",
    "brain",
    "brain_holes",
    "disconnected",
    "from_spec",
    "hexagons",
    "names",
    "paper",
    "random_triangles",
    "ring",
    "squares",
    "strip",
    "tetrahedra",
    "triangles",
    "voronoi",
]

_SAMPLES: MappingProxyType[str, Callable[..., Mesh]] = MappingProxyType(
    {
        sample.__name__: sample
        for sample in (
            triangles,
            squares,
            random_triangles,
            voronoi,
            hexagons,
            ring,
            strip,
            disconnected,
            boxes,
            tetrahedra,
            paper,
            brain,
            brain_holes,
        )
    }
)


def names() -> list[str]:
    """Names of the samples, in the order of the documentation."""
    return list(_SAMPLES)


def from_spec(spec: str) -> Mesh:
    """Mesh from a text ``name:option=value,…``; the first option may go without its name.

    Examples are ``squares:n=64``, ``squares:64``, ``voronoi:n=5000,seed=3`` and ``paper:random``.

    Raises
    ------
    OptionError
        If there is no such sample or option, or a value does not fit; lists what there is.
    """
    name, _, rest = spec.partition(":")
    sample = _SAMPLES.get(name.strip())
    if sample is None:
        close = difflib.get_close_matches(name, _SAMPLES, n=1)
        hint = f" (did you mean {close[0]!r}?)" if close else ""
        raise OptionError(f"no sample is named {name!r}{hint}; there are {', '.join(_SAMPLES)}")
    parameters = inspect.signature(sample, eval_str=True).parameters
    options: dict[str, object] = {}
    for position, item in enumerate(part.strip() for part in rest.split(",") if part.strip()):
        key, equals, text = (each.strip() for each in item.partition("="))
        if not equals and position == 0 and parameters:
            key, text = next(iter(parameters)), key
        if key not in parameters or key in options or not text:
            raise OptionError(f"cannot use {item!r} in sample {spec!r}; {_usage(sample)}")
        try:
            options[key] = parameters[key].annotation(text)
        except ValueError:
            raise OptionError(
                f"{key}={text} in sample {spec!r} is no whole number; {_usage(sample)}"
            ) from None
    missing = [p.name for p in parameters.values() if p.default is p.empty and p.name not in options]
    if missing:
        raise OptionError(f"sample {spec!r} needs a value for {', '.join(missing)}; {_usage(sample)}")
    return sample(**options)


def _usage(sample: Callable[..., Mesh]) -> str:
    parameters = inspect.signature(sample).parameters.values()
    options = [p.name if p.default is p.empty else f"{p.name} (default {p.default})" for p in parameters]
    return f"{sample.__name__} takes {', '.join(options) or 'no options'}"
