"""Reproduce the paper's tables and figures beside the printed numbers."""

from __future__ import annotations

from agglo_core.authoring import Command, hookimpl


@hookimpl
def agglo_commands() -> list[Command]:
    """Return the command ``agglo paper``."""
    return [Command("paper", "agglo_paper.command:paper", "The paper's tables and figures next to ours.")]
