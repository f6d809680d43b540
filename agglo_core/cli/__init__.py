"""The command line ``agglo``: light at start, so that help and listings import nothing numerical."""

from agglo_core.cli.app import main

__all__ = ["main"]
