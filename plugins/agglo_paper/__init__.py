"""The paper's tables and figures, ours beside the printed numbers; a study of what it does not ask."""

from __future__ import annotations

from agglo_core.authoring import Command, hookimpl


@hookimpl
def agglo_commands() -> list[Command]:
    """``agglo paper``, ``agglo study``."""
    return [
        Command("paper", "agglo_paper.command:paper", "The paper's tables and figures beside ours."),
        Command("study", "agglo_paper.study.study_command:study", "What shapes do to iterations and errors."),
    ]
