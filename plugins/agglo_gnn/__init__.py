"""Plugin with graph neural network bisectors, and commands to train and inspect the networks."""

from __future__ import annotations

from agglo_core.authoring import Command, Component, hookimpl


@hookimpl
def agglo_components() -> list[Component]:
    """Return the declarations of the bisectors ``gnn`` and ``gnn_paper``."""
    return [
        Component(
            kind="bisector",
            name="gnn",
            target="agglo_gnn.plane.fast:FastGNN",
            requires=("safetensors",),
            promises={"deterministic": True, "invariant": True, "3d": True, "pickles": True},
            summary="A learned direction and an exact sweep across it; needs no torch.",
        ),
        Component(
            kind="bisector",
            name="gnn_paper",
            target="agglo_gnn.paper.bisector:PaperGNN",
            requires=("torch", "safetensors"),
            promises={"deterministic": True, "invariant": True, "kway": True, "pickles": True},
            summary="The paper's graph neural network, or your own, in torch.",
            fallback="inertial",
        ),
    ]


@hookimpl
def agglo_commands() -> list[Command]:
    """Return the declarations of the commands ``agglo train`` and ``agglo model``."""
    return [
        Command("train", "agglo_gnn.training.command:train", "Train a graph neural network from a seed."),
        Command("model", "agglo_gnn.model:model", "Inspect a model file."),
    ]
