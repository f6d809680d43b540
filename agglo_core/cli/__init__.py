"""The command line ``agglo``: starting it is fast, as help and listings import nothing numerical."""

from agglo_core.cli.app import main

__all__ = ["main"]
