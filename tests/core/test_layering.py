"""Who may import whom, read from the source of every file: the architecture, held to its word.

Every import counts: at the top, inside a function, for type checking only.
"""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import agglo_core.authoring

ROOT = Path(__file__).parents[2]
PLUGINS = sorted(folder.name for folder in (ROOT / "plugins").glob("agglo_*") if folder.is_dir())
FILES = sorted([*(ROOT / "agglo_core").rglob("*.py"), *(ROOT / "plugins").rglob("*.py")])

EVERYBODY = {"arrays", "errors", "progress", "threads"}
"""Words that all but the registry may use; the registry uses the errors alone, so that it starts light."""

MAY_IMPORT = {
    "arrays": set(),
    "errors": set(),
    "moved": set(),
    "progress": {"errors"},
    "registry": {"errors"},
    "threads": {"errors"},
    "kernels": EVERYBODY,
    "packaging": set(),
    "mesh": EVERYBODY | {"kernels"},
    "graph": EVERYBODY | {"kernels", "mesh"},
    "hierarchy": EVERYBODY | {"graph", "kernels", "mesh"},
    "problems": EVERYBODY | {"hierarchy", "mesh", "registry"},
    "multigrid": EVERYBODY | {"graph", "hierarchy", "kernels", "mesh", "problems", "registry"},
    "protocols": EVERYBODY | {"graph", "hierarchy", "mesh", "problems"},
    "agglomeration": EVERYBODY | {"graph", "hierarchy", "kernels", "mesh", "protocols", "registry"},
    "components": EVERYBODY | {"graph", "kernels", "mesh", "protocols", "registry"},
    "samples": EVERYBODY | {"mesh", "registry"},
    "io": EVERYBODY | {"hierarchy", "mesh", "problems", "registry"},
    "interchange": EVERYBODY | {"graph", "hierarchy", "io", "kernels", "mesh"},
    "measure": EVERYBODY | {"graph", "hierarchy", "mesh", "protocols", "registry"},
    "draw": EVERYBODY
    | {"graph", "hierarchy", "interchange", "io", "kernels", "measure", "mesh", "problems", "registry"},
    "conformance": EVERYBODY
    | {"agglomeration", "components", "graph", "hierarchy", "io", "measure", "mesh", "problems"}
    | {"protocols", "registry", "samples"},
    "distributed": EVERYBODY
    | {"agglomeration", "components", "graph", "hierarchy", "io", "kernels", "measure", "mesh", "problems"}
    | {"protocols", "registry"},
    "cli": EVERYBODY
    | {"agglomeration", "conformance", "distributed", "draw", "hierarchy", "io", "kernels", "measure", "mesh"}
    | {"problems", "protocols", "registry", "samples"},
}
"""The folders of the core (and its few loose modules), and what each may import: arrows run one way."""

LOOSE = {"__init__", "__main__", "arrays", "authoring", "errors", "moved", "threads"}


def dotted(file: Path) -> str:
    """Dotted name of the module in a file of the core or a plugin."""
    parts = file.relative_to(ROOT).with_suffix("").parts
    parts = parts[1:] if parts[0] == "plugins" else parts
    return ".".join(part for part in parts if part != "__init__")


MODULES = {dotted(file): file for file in FILES}


def imported(file: Path) -> Iterator[tuple[str, str]]:
    """Each ``(module, name)`` a file imports; the name is empty for ``import module``."""
    package = dotted(file).split(".")
    package = package if file.name == "__init__.py" else package[:-1]
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*above, *(node.module or "").split(".")]).strip(".")
            yield from ((module, alias.name) for alias in node.names)


def modules_imported(file: Path) -> Iterator[str]:
    """Modules of the core and the plugins that a file imports."""
    for module, name in imported(file):
        whole = f"{module}.{name}"
        if whole in MODULES or module in MODULES:
            yield whole if whole in MODULES else module


def room(module: str) -> str:
    """Folder or loose module of the core that a module belongs to; empty for ``agglo_core`` itself."""
    return [*module.split("."), ""][1]


def test_there_is_something_to_read() -> None:
    assert FILES
    assert PLUGINS


@pytest.mark.parametrize("file", [f for f in FILES if "agglo_core" in f.parts], ids=dotted)
def test_arrows_between_folders_run_one_way(file: Path) -> None:
    own = room(dotted(file))
    if own in ("", "__main__", "authoring"):  # the faces of the house: everything can be had there
        return
    for module in modules_imported(file):
        top, there = module.split(".")[0], room(module)
        assert top == "agglo_core", f"{dotted(file)} imports the plugin {module}"
        if there == own or (there == "" and own == "cli"):  # the command line knows the version
            continue
        allowed = ", ".join(sorted(MAY_IMPORT[own]))
        assert there in MAY_IMPORT[own], f"{dotted(file)} imports {module}; {own} may import: {allowed}"


def test_the_table_has_no_circle() -> None:
    order = list(TopologicalSorter(MAY_IMPORT).static_order())
    assert len(order) == len(MAY_IMPORT)


def test_no_two_modules_import_each_other() -> None:
    arrows = {name: {other for other in modules_imported(MODULES[name]) if other != name} for name in MODULES}
    try:
        list(TopologicalSorter(arrows).static_order())
    except CycleError as error:
        raise AssertionError(f"a circle of imports: {' <- '.join(error.args[1])}") from None


@pytest.mark.parametrize("file", [f for f in FILES if "plugins" in f.parts], ids=dotted)
def test_plugins_import_what_any_author_may(file: Path) -> None:
    own = dotted(file).split(".")[0]
    for module, name in imported(file):
        top = module.split(".")[0]
        assert top not in PLUGINS or top == own, f"{dotted(file)} imports the plugin {module}"
        named = module == "agglo_core.authoring" and name in agglo_core.authoring.__all__
        assert top != "agglo_core" or named, (
            f"{dotted(file)} imports {module}.{name}: not agglo_core.authoring"
        )


@pytest.mark.parametrize("name", agglo_core.authoring.__all__)
def test_every_name_for_authors_can_be_had(name: str) -> None:
    assert name in dir(agglo_core.authoring)
    assert getattr(agglo_core.authoring, name) is not None


@pytest.mark.parametrize("file", FILES, ids=dotted)
def test_private_names_stay_at_home(file: Path) -> None:
    for module, name in imported(file):
        private = [
            part for part in [*module.split("."), name] if part.startswith("_") and part != "__future__"
        ]
        dunder = all(part.startswith("__") and part.endswith("__") for part in private)
        assert dunder, f"{dotted(file)} imports {'.'.join(private)} of {module}"


def test_no_name_of_a_plugin_is_written_into_the_core() -> None:
    for file in FILES:
        if dotted(file).startswith("agglo_core"):
            strings = [n.value for n in ast.walk(ast.parse(file.read_text())) if isinstance(n, ast.Constant)]
            named = [s for s in strings if isinstance(s, str) and s.split(":")[0].split(".")[0] in PLUGINS]
            assert not named, f"{dotted(file)} names {named}"


def test_the_top_of_the_core_is_folders() -> None:
    loose = {file.stem for file in (ROOT / "agglo_core").glob("*.py")}
    assert loose <= LOOSE
    folders = {file.parent.name for file in (ROOT / "agglo_core").glob("*/__init__.py")}
    assert folders | loose - {"__init__", "__main__", "authoring"} == set(MAY_IMPORT)


def test_no_two_modules_have_the_same_name() -> None:
    stems = Counter(file.stem for file in FILES if not file.stem.startswith("__"))
    packages = Counter(file.parent.name for file in FILES if file.name == "__init__.py")
    twice = {name: count for name, count in (stems + packages).items() if count > 1}
    assert not twice


@pytest.mark.parametrize("file", FILES, ids=dotted)
def test_files_fit_in_the_head(file: Path) -> None:
    assert len(file.read_text().splitlines()) <= 300
