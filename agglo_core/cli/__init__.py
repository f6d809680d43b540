"""Command line ``agglo``, with fast start-up: help and listings import no numerical packages."""

from agglo_core.cli.app import main

__all__ = ["main"]
