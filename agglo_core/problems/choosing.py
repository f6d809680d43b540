"""Choice of problems by name or from a TOML file, with checks that a solver accepts them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from agglo_core.errors import AggloError, FileError, OptionError, PluginError
from agglo_core.mesh import Mesh
from agglo_core.problems.discretisation import Discretisation, Problem
from agglo_core.registry import Registry, default, describe
from agglo_core.registry.attribution import attributed
from agglo_core.registry.code_options import mark_texts
from agglo_core.registry.construct import resolve
from agglo_core.registry.containment import shown
from agglo_core.registry.toml_files import read_toml

_KIND = "problem"
_OFFERED = ("accepts", *sorted(name for name in vars(Discretisation) if not name.startswith("_")))
_NO_OPTIONS: Mapping[str, Any] = MappingProxyType({})


def named_problem(
    name: str,
    mesh: Mesh,
    options: Mapping[str, Any] = _NO_OPTIONS,
    registry: Registry | None = None,
    *,
    allow_code: bool = False,
) -> Problem:
    """Return the problem with a component name or from a TOML file, posed on a mesh.

    Parameters
    ----------
    name : str
        ``constant``, ``sine``, another component of kind ``problem``, or a path.
    mesh : Mesh
    options : mapping
        Component options.
    registry : Registry, optional
        Registry of names. Default: the installed plugins.
    allow_code : bool
        Allow files to name code that components import, see :func:`agglo_core.agglomerate`.

    Raises
    ------
    FileError
        As :func:`read_problem`, if no component has this name.
    OptionError
        For an unknown or invalid option.
    PluginError
        If the component cannot be used.

    Examples
    --------
    >>> import agglo_core as agglo
    >>> from agglo_core.problems import named_problem
    >>> problem = named_problem("sine", agglo.samples.squares(4))
    >>> problem.kind, problem.exact is not None
    ('diffusion', True)
    """
    registry = default() if registry is None else registry
    if Path(name).suffix.lower() == ".toml" or not _is_declared(name, registry):
        if options:
            raise OptionError(
                f"no problem is named {name!r} ({_list_problems(registry)}), and problem files take no "
                "options"
            )
        problem = read_problem(Path(name), mesh, registry, allow_code=allow_code)
    else:
        problem = _check_problem(
            registry.build(_KIND, name, **options), describe(registry.record(_KIND, name))
        )
    posed_on = getattr(problem, "posed_on", None)
    return problem if posed_on is None else posed_on(mesh)


def read_problem(
    path: Path, mesh: Mesh, registry: Registry | None = None, *, allow_code: bool = False
) -> Problem:
    """Read a problem for ``mesh`` from a TOML file. The key ``kind`` defaults to diffusion.

    Raises
    ------
    FileError
        If the file cannot be read, its kind is unknown, or the kind refuses an entry. Names the key.

    Examples
    --------
    >>> from pathlib import Path
    >>> import agglo_core as agglo
    >>> from agglo_core.problems import read_problem
    >>> path = Path("problem.toml")
    >>> _ = path.write_text('kind = "diffusion"\\nkappa = 3.0\\n')
    >>> read_problem(path, agglo.samples.squares(4)).kind
    'diffusion'
    """
    registry = default() if registry is None else registry
    if not os.path.exists(path) or path.is_dir():  # False for an invalid file name
        raise FileError(f"{path}: {_describe_missing_file(path, registry)}")
    table = read_toml(path)
    kind = table.pop("kind", "diffusion")
    table = table if allow_code else mark_texts(table)
    try:
        from_table, title = _reader_of(kind, registry)
        with attributed(title, spare=(AggloError, OSError, MemoryError)):
            problem = from_table(table, mesh, path.parent)
        return _check_problem(problem, f"{title}: from_table")
    except (AggloError, OSError, MemoryError) as error:
        raise FileError(f"{path}: {str(error) or repr(error)}") from error


def require_accepted(solver: object, problem: Problem, name: str = "") -> None:
    """Raise OptionError if a solver lists accepted kinds and the problem's kind is not among them.

    ``name`` names the solver in the message (default: its class). An ``accepts`` given as text instead of a
    tuple is a PluginError.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> from agglo_core.problems import Diffusion, require_accepted
    >>> require_accepted(SimpleNamespace(accepts=("elasticity",)), Diffusion(), "mine")
    Traceback (most recent call last):
        ...
    agglo_core.errors.OptionError: mine takes problems of kind elasticity; given one of kind diffusion
    """
    accepts, title = getattr(solver, "accepts", None), name or type(solver).__name__
    if isinstance(accepts, str):
        raise PluginError(f"{title}: accepts is {accepts!r}, expected a tuple such as ('{accepts}',)")
    if accepts is not None and problem.kind not in accepts:
        matrix = "; assemble it, and give Linear(system.A, system.b, near_null=system.near_null)"
        raise OptionError(
            f"{title} takes problems of kind {', '.join(accepts)}; given one of kind {problem.kind}"
            + (matrix if "linear" in accepts else "")
        )


def discretisation_of(solver: object, problem: Problem) -> Discretisation | None:
    """Return the discretisation behind a solver's unknowns, or None if it has none for the problem.

    Raises
    ------
    OptionError
        If the solver's ``discretisation`` lacks a required method or attribute.

    Examples
    --------
    >>> from agglo_core.problems import Diffusion, discretisation_of
    >>> from agglo_core.registry import default
    >>> solver = default().build("solver", "polydg_mg", degree=2)
    >>> discretisation_of(solver, Diffusion()) is not None
    True
    """
    discretisation = discretisation_for(getattr(solver, "discretisation", None), problem)
    if discretisation is None:
        return None
    lacking = [name for name in _OFFERED if not hasattr(discretisation, name)]
    if lacking:
        raise OptionError(f"the discretisation of {type(solver).__name__} lacks {', '.join(lacking)}")
    return discretisation if problem.kind in discretisation.accepts else None


def discretisation_for(discretisation: Any, problem: Problem) -> Any:
    """Return the discretisation for the problem's kind that a given one offers by ``of_kind``, or itself.

    Examples
    --------
    >>> from agglo_core.problems.choosing import discretisation_for
    >>> polydg = agglo.registry.default().build("discretisation", "polydg", degree=2)
    >>> discretisation_for(polydg, agglo.Elasticity())
    PolyDGElasticity(degree=2)
    """
    of_kind, kind = getattr(discretisation, "of_kind", None), getattr(problem, "kind", None)
    return discretisation if of_kind is None or kind is None else of_kind(kind)


def _is_declared(name: str, registry: Registry) -> bool:
    try:
        registry.record(_KIND, name)
    except PluginError:
        return False
    return True


def _check_problem(problem: Any, maker: str) -> Problem:
    if not isinstance(getattr(problem, "kind", None), str):
        raise PluginError(
            f"{maker} returned {shown(problem)}, expected a problem with the name of its kind in the "
            "attribute kind"
        )
    return problem  # type: ignore[no-any-return]


def _reader_of(kind: Any, registry: Registry) -> tuple[Any, str]:
    """Return the function ``from_table`` that reads problems of a kind, and its title for error messages."""
    if not isinstance(kind, str):
        raise OptionError(f"kind must be the name of a problem kind, given {kind!r:.60}")
    record = registry.record(_KIND, kind)
    target = resolve(record)
    from_table = getattr(target, "from_table", None)
    if from_table is None and isinstance(target, type):
        raise PluginError(f"{describe(record)} has no method from_table(table, mesh, folder)")
    if from_table is None:
        raise OptionError(
            f"kind: {describe(record)} cannot be read from a file: select it by its name instead"
        )
    return from_table, describe(record)


def _describe_missing_file(path: Path, registry: Registry) -> str:
    if os.path.isdir(path):
        return f"a folder; a problem is a .toml file or a name ({_list_problems(registry)})"
    return f"no such file, and no problem of that name ({_list_problems(registry)})"


def _list_problems(registry: Registry) -> str:
    return ", ".join(sorted({r.name for r in registry.list() if r.kind == _KIND and r.state == "ok"}))
