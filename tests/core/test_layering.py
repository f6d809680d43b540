"""Who may import whom, read from the source of every file."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PLUGINS = sorted(folder.name for folder in (ROOT / "plugins").glob("agglo_*") if folder.is_dir())
FILES = sorted([*(ROOT / "agglo_core").rglob("*.py"), *(ROOT / "plugins").rglob("*.py")])


def dotted(file: Path) -> str:
    """Dotted name of the module in a file of the core or a plugin."""
    parts = file.relative_to(ROOT).with_suffix("").parts
    parts = parts[1:] if parts[0] == "plugins" else parts
    return ".".join(part for part in parts if part != "__init__")


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


def test_there_is_something_to_read() -> None:
    assert FILES
    assert PLUGINS


@pytest.mark.parametrize("file", FILES, ids=dotted)
def test_imports_go_one_way(file: Path) -> None:
    own = dotted(file).split(".")[0]
    for module, _ in imported(file):
        top = module.split(".")[0]
        assert top not in PLUGINS or top == own, f"{dotted(file)} imports the plugin {module}"
        if module.startswith("agglo_core.cli") and module != "agglo_core.cli.arguments":
            inside = dotted(file).startswith(("agglo_core.cli", "agglo_core.__main__"))
            assert inside, f"{dotted(file)} imports the command line"
        if module == "agglo_core.cli.arguments":
            assert own != "agglo_core" or dotted(file).startswith("agglo_core.cli"), (
                f"{dotted(file)} imports what is for commands"
            )
        if dotted(file).startswith("agglo_core.registry") and top == "agglo_core":
            assert module.startswith(("agglo_core.registry", "agglo_core.errors")), (
                f"the registry imports {module}"
            )


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
