"""Create sample meshes by name or text, from this package and from plugins."""

from __future__ import annotations

from collections.abc import Sequence

from agglo_core.errors import OptionError, PluginError
from agglo_core.mesh import Mesh
from agglo_core.registry import Record, Registry, default, describe
from agglo_core.registry.construct import check_options, resolve
from agglo_core.registry.containment import shown
from agglo_core.registry.option_types import Text
from agglo_core.registry.options import Option, options_of


def names(registry: Registry | None = None) -> list[str]:
    """Return the names of all samples that can be used, agglo's own before those of plugins.

    Parameters
    ----------
    registry : Registry, optional
        Registry for name look-up. Default: the installed plugins.

    Examples
    --------
    >>> agglo.samples.names()[:3]
    ['triangles', 'squares', 'random_triangles']
    """
    records = (default() if registry is None else registry).list()
    usable = [record for record in records if record.kind == "sample" and record.state == "ok"]
    return [record.name for record in sorted(usable, key=lambda record: not record.in_tree)]


def from_spec(spec: str, registry: Registry | None = None) -> Mesh:
    """Create a mesh from a text ``name:option=value,…``.

    The first option's name may be omitted.

    Parameters
    ----------
    spec : str
        For example ``squares:n=64``, ``squares:64``, ``voronoi:n=5000,seed=3`` or ``paper:random``. The name
        may be qualified as ``plugin/name``.
    registry : Registry, optional
        Registry for name look-up. Default: the installed plugins.

    Raises
    ------
    OptionError
        If the sample or an option is unknown, or a value does not fit. The message lists the options.
    PluginError
        If the sample cannot be used, fails, or returns something other than a Mesh.

    Examples
    --------
    >>> from agglo_core import samples
    >>> samples.from_spec("voronoi:300,seed=3").n_cells
    300
    """
    # 1. Look up the sample.
    name, _, option_text = spec.partition(":")
    source = default() if registry is None else registry
    try:
        record = source.record("sample", name.strip())
    except PluginError as error:
        raise OptionError(str(error)) from error
    # 2. Parse and check the options.
    target = resolve(record)
    accepted = options_of(target) or ()
    try:
        options = check_options(record, target, _parse_options(spec, option_text, accepted))
    except OptionError as error:
        raise OptionError(f"{error}; {_usage(record, accepted)}") from error
    # 3. Create the mesh.
    mesh = source.assemble(record, options)
    if not isinstance(mesh, Mesh):
        raise PluginError(f"{describe(record)} returned {shown(mesh)}, expected a Mesh")
    return mesh


def _parse_options(spec: str, option_text: str, accepted: Sequence[Option]) -> dict[str, Text]:
    """Split ``option=value,…`` into options, without conversion of the values."""
    options: dict[str, Text] = {}
    items = [item.strip() for item in option_text.split(",") if item.strip()]
    for position, item in enumerate(items):
        option, equals, value = (part.strip() for part in item.partition("="))
        if not equals and position == 0 and accepted:
            option, value = accepted[0].name, option
        if not option or not value or option in options:
            raise OptionError(
                f"cannot use {item!r} in sample {spec!r}: expected option=value, with each option at most "
                "once"
            )
        options[option] = Text(value)
    return options


def _usage(record: Record, accepted: Sequence[Option]) -> str:
    defaults = ["" if option.required else f", default {option.default}" for option in accepted]
    options = [f"{o.name} ({o.type_name}{default})" for o, default in zip(accepted, defaults, strict=True)]
    return f"{record.name} takes {', '.join(options) or 'no options'}"
