"""The documentation site: ``sphinx-build -W docs build/site`` makes it from the Markdown here, offline."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from pygments.lexers.special import TextLexer

import agglo_core

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "extensions"))

project = "agglo"
author = copyright = "The agglo developers"
release = version = agglo_core.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "command_reference",
    "component_tables",
    "gallery_pages",
    "metric_reference",
    "module_index",
    "notebook_pages",
    "public_names",
    "toml_keys",
]
exclude_patterns = ["brain", "extensions", "notebooks/run", "studies", "README.md"]
root_doc = "index"

myst_heading_anchors = 4  # as a code host makes them: headings can be linked to without labels
myst_enable_extensions = ["colon_fence", "deflist"]

autosummary_generate = False  # public_names makes a page of each module, not one of each name
autodoc_typehints = "none"  # numpydoc says the types and shapes
autodoc_member_order = "bysource"
autodoc_mock_imports = ["torch"]
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

suppress_warnings = ["myst.header"]  # tables of results begin two levels below their page

html_theme = "furo"
html_title = f"agglo {release}"
html_static_path = ["site"]
html_css_files = ["wide_tables.css"]
html_copy_source = False


def setup(app: Any) -> None:
    """``output`` blocks of the guides are plain text."""
    app.add_lexer("output", TextLexer)
