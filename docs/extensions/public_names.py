"""The directive ``public-names MODULE``: every name of its ``__all__``, with its docstring.

What a module further up has shown is named with a link there: ``agglo_core.Mesh`` is not described twice.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from importlib import import_module
from typing import Any, get_origin

from documented import MODULES
from docutils import nodes
from docutils.statemachine import StringList
from sphinx.util.docutils import SphinxDirective


class PublicNames(SphinxDirective):
    """One entry for each public name of a module."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Parse the lines that describe the module."""
        module = self.arguments[0]
        self.env.note_dependency(inspect.getsourcefile(import_module(module)) or "")
        text = ["```{eval-rst}", *described(module), "```"]
        lines = StringList(text, source=f"{module}.__all__")
        box = nodes.container()
        self.state.nested_parse(lines, self.content_offset, box)
        return box.children


def described(module: str) -> Iterator[str]:
    """The lines of reStructuredText for a module."""
    found = import_module(module)
    for name in found.__all__:
        value = getattr(found, name)
        home = first_home(name, value, module)
        if inspect.ismodule(value):
            yield from ("", f"``{name}``", f"   The module :py:mod:`{value.__name__}`.")
        elif get_origin(value) is not None:
            yield from ("", f"``{name}``", f"   The type ``{written(value)}``.")
        elif home is not None:
            role = "class" if inspect.isclass(value) else "func"
            yield from ("", f"``{name}``", f"   The same as :py:{role}:`{home}`.")
        elif inspect.isclass(value):
            yield from (
                "",
                f".. autoclass:: {module}.{name}",
                "   :members:",
                "   :inherited-members: BaseException, dict, tuple, str",
            )
        elif inspect.isroutine(value):
            yield from ("", f".. autofunction:: {module}.{name}")
        else:
            yield from ("", f".. autodata:: {module}.{name}", "   :no-value:")
    yield ""


def written(alias: Any) -> str:
    """A type as it would be annotated, without the names of numpy's own modules."""
    return (
        str(alias)
        .replace("typing.", "")
        .replace("numpy.dtype", "dtype")
        .replace("agglo_core.protocols.on_constraints.", "")
    )


def first_home(name: str, value: Any, module: str) -> str | None:
    """The full name under which an earlier module shows the same thing."""
    for earlier in MODULES[: MODULES.index(module)]:
        found = import_module(earlier)
        if name in found.__all__ and getattr(found, name) is value and not isinstance(value, str):
            return f"{earlier}.{name}"
    return None


def setup(app: Any) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("public-names", PublicNames)
    return {"parallel_read_safe": True}
