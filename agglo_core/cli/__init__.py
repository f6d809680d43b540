"""Command line ``agglo``. Help and listings start fast, without an import of numerical packages."""

from agglo_core.cli.app import main

__all__ = ["main"]
