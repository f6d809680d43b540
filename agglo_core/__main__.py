"""Command line entry point for ``python -m agglo_core``."""

from agglo_core.cli import main

if __name__ == "__main__":
    main()
