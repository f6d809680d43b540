"""Entry point of ``python -m agglo_core``: the command line."""

from agglo_core.cli import main

if __name__ == "__main__":
    main()
