"""The directive ``command-line``: a section for each command of agglo, with the help that it prints."""

from __future__ import annotations

from typing import Any

import click
from docutils import nodes
from sphinx.util.docutils import SphinxDirective

from agglo_core.cli.app import app as agglo

_COLUMNS = 80


class CommandLine(SphinxDirective):
    """``agglo --help`` and the help of every command, also of those that plugins add."""

    def run(self) -> list[nodes.Node]:
        """One section a command."""
        return [self._section(name, text) for name, text in helps(agglo, "agglo")]

    def _section(self, name: str, text: str) -> nodes.section:
        section = nodes.section(ids=[nodes.make_id(name)], names=[nodes.fully_normalize_name(name)])
        section += nodes.title(text=name)
        section += nodes.literal_block(text, text, language="text")
        self.state.document.note_implicit_target(section, section)
        return section


def helps(command: click.Command, name: str, parent: click.Context | None = None) -> list[tuple[str, str]]:
    """Names and help texts of a command and of all below it."""
    context = _context(command, name, parent)
    found = [(context.command_path, context.command.get_help(context))]
    if isinstance(command, click.Group):
        for below in command.list_commands(context):
            inner = command.get_command(context, below)
            if inner is not None:
                found += helps(_real(below, inner), below, context)
    return found


def _real(name: str, command: click.Command) -> click.Command:
    """What a plugin's command stands for: commands of plugins are imported when they are run."""
    from agglo_core.registry import default
    from agglo_core.registry.construct import resolve

    if command.add_help_option:
        return command
    found: Any = resolve(default().record("command", name))
    return found if isinstance(found, click.Command) else command


def _context(command: click.Command, name: str, parent: click.Context | None) -> click.Context:
    return click.Context(
        command,
        info_name=name,
        parent=parent,
        max_content_width=_COLUMNS,
        terminal_width=_COLUMNS,
        **command.context_settings,
    )


def setup(app: Any) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("command-line", CommandLine)
    return {"parallel_read_safe": True}
