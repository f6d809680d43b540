"""The extra ``docs`` installs every package that the documentation site imports."""

from __future__ import annotations

import ast
import json
import re
import sys
import tomllib
from importlib.metadata import packages_distributions, requires
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
SCRIPTS = [DOCS / "conf.py", *DOCS.glob("extensions/*.py"), *DOCS.glob("gallery/*.py")]
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))


def names(requirements: list[str]) -> set[str]:
    """Return the distributions of requirements, with those of the extras of agglo that they name."""
    found = set()
    for each in requirements:
        extras = re.match(r"agglo\[(.+)\]$", each)
        if extras:
            found |= names([inner for extra in extras[1].split(",") for inner in EXTRAS[extra]])
        else:
            found.add(re.match(r"[\w.-]+", each)[0].lower().replace("_", "-"))
    return found


def imported() -> set[str]:
    """Return the packages that configuration, extensions, gallery and notebooks import, also in functions."""
    sources = [script.read_text(encoding="utf-8") for script in SCRIPTS]
    for notebook in NOTEBOOKS:
        cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
        sources += ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    modules = set()
    for node in (node for source in sources for node in ast.walk(ast.parse(source))):
        if isinstance(node, ast.Import):
            modules |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            modules.add(str(node.module).partition(".")[0])
    inside = (
        {path.stem for path in SCRIPTS}
        | {path.name for path in (ROOT / "plugins").iterdir()}
        | {"agglo_core"}
    )
    return modules - inside - set(sys.stdlib_module_names)


def test_the_extra_has_what_the_site_imports() -> None:
    pytest.importorskip("sphinx")
    required = names(PROJECT["dependencies"]) | names(EXTRAS["docs"])
    required |= names([each for each in requires("sphinx") or [] if "extra ==" not in each])
    distributions = packages_distributions()
    lacking = {
        module
        for module in imported()
        if not required & {each.lower().replace("_", "-") for each in distributions.get(module, [module])}
    }
    assert lacking == set()


def test_the_extra_has_the_kernel_of_the_notebooks() -> None:
    kernels = {
        json.loads(path.read_text(encoding="utf-8"))["metadata"]["kernelspec"]["name"] for path in NOTEBOOKS
    }
    assert kernels == {"python3"}
    assert "ipykernel" in names(EXTRAS["docs"])
