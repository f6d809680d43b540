"""Import rules of the architecture, checked on the source of every file.

Every import counts: at the top, inside a function, for type checking only; exceptions are in ``LATER``. Each
test lists all offenders.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

from syntax import syntax_tree

import agglo_core.authoring

ROOT = Path(__file__).parents[2]
PLUGINS = sorted(folder.name for folder in (ROOT / "plugins").glob("agglo_*") if folder.is_dir())
FILES = sorted([*(ROOT / "agglo_core").rglob("*.py"), *(ROOT / "plugins").rglob("*.py")])

EVERYBODY = {"arrays", "errors", "files", "progress", "suggestions", "threads"}
"""Modules that all folders may import, except the registry, which starts fast without numpy."""

MAY_IMPORT = {
    "arrays": {"errors"},
    "builtin": {"registry"},
    "errors": set(),
    "files": {"arrays", "errors"},
    "lazy_names": set(),
    "packaging": set(),
    "progress": {"errors"},
    "registry": {"errors", "files", "suggestions"},
    "suggestions": set(),
    "threads": {"errors"},
    "compiled": EVERYBODY | {"lazy_names"},
    "mesh": EVERYBODY | {"compiled"},
    "graph": EVERYBODY | {"compiled", "mesh"},
    "hierarchy": EVERYBODY | {"compiled", "graph", "mesh"},
    "problems": EVERYBODY | {"hierarchy", "mesh", "registry"},
    "fields": EVERYBODY | {"mesh", "problems"},
    "multigrid": EVERYBODY | {"compiled", "graph", "hierarchy", "mesh", "problems", "registry"},
    "solvers": EVERYBODY | {"graph", "hierarchy", "mesh", "multigrid", "problems", "registry"},
    "protocols": EVERYBODY | {"graph", "hierarchy", "mesh", "problems"},
    "refine": EVERYBODY | {"compiled", "graph", "mesh", "protocols", "registry"},
    "split": EVERYBODY | {"compiled", "graph", "mesh", "protocols", "refine", "registry"},
    "anneal": EVERYBODY | {"compiled", "graph", "mesh", "protocols", "refine", "registry", "split"},
    "shapes": EVERYBODY | {"compiled", "graph", "mesh", "protocols", "registry"},
    "constraints": EVERYBODY | {"compiled", "graph", "mesh", "protocols", "refine", "registry"},
    "agglomeration": EVERYBODY
    | {
        "compiled",
        "constraints",
        "graph",
        "hierarchy",
        "lazy_names",
        "mesh",
        "protocols",
        "registry",
        "split",
    },
    "adaptivity": EVERYBODY | {"agglomeration", "hierarchy", "mesh", "problems", "registry", "solvers"},
    "samples": EVERYBODY | {"mesh", "registry"},
    "io": EVERYBODY | {"hierarchy", "mesh", "problems", "registry"},
    "interchange": EVERYBODY | {"compiled", "graph", "hierarchy", "io", "mesh", "problems"},
    "measure": EVERYBODY | {"compiled", "graph", "hierarchy", "mesh", "protocols", "registry"},
    "draw": EVERYBODY
    | {"compiled", "graph", "hierarchy", "interchange", "io", "measure", "mesh", "problems", "registry"},
    "conformance": EVERYBODY
    | {"agglomeration", "builtin", "graph", "hierarchy", "io", "measure", "mesh", "problems"}
    | {"protocols", "registry", "samples"},
    "distributed": EVERYBODY
    | {"agglomeration", "compiled", "constraints", "graph", "hierarchy", "io", "measure", "mesh"}
    | {"problems", "protocols", "registry", "shapes"},
    "cli": EVERYBODY
    | {
        "adaptivity",
        "agglomeration",
        "compiled",
        "conformance",
        "distributed",
        "draw",
        "hierarchy",
        "interchange",
        "io",
    }
    | {"measure", "mesh", "problems", "protocols", "registry", "samples", "solvers"},
}
"""The folders and loose modules of the core, and those that each may import."""

LATER = {
    "agglo_core.graph.dual": {"interchange"},
    "agglo_core.hierarchy.levels": {"io", "measure"},
    "agglo_core.mesh.polytopal": {"graph", "interchange", "io"},
    "agglo_core.solvers.fine_system": {"agglomeration"},
}
"""Modules with methods that import from a later folder when they are called, such as ``mesh.graph``."""

LOOSE = {"__init__", "__main__", "arrays", "authoring", "builtin", "errors"}
LOOSE |= {"lazy_names", "suggestions", "threads"}


def dotted(file: Path) -> str:
    """Return the dotted name of the module in a file of the core or a plugin."""
    parts = file.relative_to(ROOT).with_suffix("").parts
    parts = parts[1:] if parts[0] == "plugins" else parts
    return ".".join(part for part in parts if part != "__init__")


MODULES = {dotted(file): file for file in FILES}
CORE = [name for name in MODULES if name.startswith("agglo_core")]


@cache
def imported(module: str) -> list[tuple[str, str]]:
    """List each ``(module, name)`` that a module imports; the name is empty for ``import module``."""
    package = module.split(".")
    package = package if MODULES[module].name == "__init__.py" else package[:-1]
    pairs: list[tuple[str, str]] = []
    for node in ast.walk(syntax_tree(MODULES[module])):
        if isinstance(node, ast.Import):
            pairs += [(alias.name, "") for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else []
            source = ".".join([*above, *(node.module or "").split(".")]).strip(".")
            pairs += [(source, alias.name) for alias in node.names]
    return pairs


def modules_imported(module: str) -> Iterator[str]:
    """Yield the modules of the core and the plugins that a module imports."""
    for source, name in imported(module):
        whole = f"{source}.{name}"
        if whole in MODULES or source in MODULES:
            yield whole if whole in MODULES else source


def folder_of(module: str) -> str:
    """Return the folder or loose module of the core that holds a module; empty for ``agglo_core`` itself."""
    return [*module.split("."), ""][1]


def report(offenders: list[str]) -> None:
    """Fail with all offenders, one a line."""
    assert not offenders, "\n".join(offenders)


def test_folders_import_only_what_the_table_allows() -> None:
    offenders = []
    for module in CORE:
        folder = folder_of(module)
        if folder in ("", "__main__", "authoring"):  # the public faces re-export from everywhere
            continue
        for other in modules_imported(module):
            target = folder_of(other)
            allowed = other.startswith("agglo_core") and (
                target in MAY_IMPORT[folder] | {folder} | LATER.get(module, set())
                or (target == "" and folder == "cli")
            )
            if not allowed:
                offenders.append(
                    f"{module} imports {other}; {folder} may import {sorted(MAY_IMPORT[folder])}"
                )
    report(offenders)


def test_the_table_has_no_cycle() -> None:
    order = list(TopologicalSorter(MAY_IMPORT).static_order())
    assert len(order) == len(MAY_IMPORT)


def test_no_two_modules_import_each_other() -> None:
    arrows = {
        name: {
            other
            for other in modules_imported(name)
            if other != name and folder_of(other) not in LATER.get(name, ())
        }
        for name in MODULES
    }
    assert len(arrows) > 100
    try:
        list(TopologicalSorter(arrows).static_order())
    except CycleError as error:
        raise AssertionError(f"a cycle of imports: {' <- '.join(error.args[1])}") from None


def test_later_folders_are_imported_by_methods_alone() -> None:
    for module, folders in LATER.items():
        assert folders <= {folder_of(other) for other in modules_imported(module)}
        for node in syntax_tree(MODULES[module]).body:
            if isinstance(node, ast.Import | ast.ImportFrom):
                names = (
                    [node.module or ""] if isinstance(node, ast.ImportFrom) else [a.name for a in node.names]
                )
                assert not folders & set(map(folder_of, names))


def test_plugins_import_public_names_from_the_authoring_module() -> None:
    offenders = []
    for module in MODULES.keys() - set(CORE):
        own = module.split(".")[0]
        assert own in PLUGINS
        for source, name in imported(module):
            top = source.split(".")[0]
            public = name in agglo_core.authoring.__all__
            misplaced = top == "agglo_core" and public != (source == "agglo_core.authoring")
            if (top in PLUGINS and top != own) or misplaced:
                offenders.append(f"{module} imports {source}.{name}")
    report(offenders)


def test_every_name_for_authors_exists() -> None:
    missing = [
        name
        for name in agglo_core.authoring.__all__
        if name not in dir(agglo_core.authoring) or getattr(agglo_core.authoring, name) is None
    ]
    report(missing)


def test_private_names_are_not_imported() -> None:
    offenders = []
    for module in MODULES:
        for source, name in imported(module):
            private = [part for part in [*source.split("."), name] if part.startswith("_")]
            if not all(part.startswith("__") and part.endswith("__") for part in private):
                offenders.append(f"{module} imports {source}.{name}")
    report(offenders)


def test_the_core_names_no_plugin() -> None:
    offenders = []
    for module in CORE:
        constants = [
            node.value for node in ast.walk(syntax_tree(MODULES[module])) if isinstance(node, ast.Constant)
        ]
        strings = [value for value in constants if isinstance(value, str)]
        offenders += [f"{module} names {s}" for s in strings if s.split(":")[0].split(".")[0] in PLUGINS]
    report(offenders)


def test_the_top_of_the_core_is_folders() -> None:
    loose = {file.stem for file in (ROOT / "agglo_core").glob("*.py")}
    assert loose <= LOOSE
    folders = {file.parent.name for file in (ROOT / "agglo_core").glob("*/__init__.py")}
    assert folders | loose - {"__init__", "__main__", "authoring"} == set(MAY_IMPORT)


def test_virtual_elements_import_authoring_alone() -> None:
    """The second method is a plugin like any stranger's."""
    own = [module for module in MODULES if module.startswith("agglo_vem")]
    allowed = ("agglo_core.authoring", "agglo_vem")
    report([f"{m}: {name}" for m in own for name in modules_imported(m) if not name.startswith(allowed)])
