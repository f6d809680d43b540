"""Plugin that recomputes the paper's tables and figures, and prints them beside the published numbers."""

from __future__ import annotations

from agglo_core.authoring import Command, hookimpl


@hookimpl
def agglo_commands() -> list[Command]:
    """Return the declaration of the command ``agglo paper``."""
    return [Command("paper", "agglo_paper.command:paper", "The paper's tables and figures next to ours.")]
