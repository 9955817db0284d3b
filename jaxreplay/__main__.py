"""The command `jaxreplay`, also as `python -m jaxreplay`."""

import sys

from jaxreplay.cli.stop import stop_on_signals


def main() -> int:
    """Run the command line; signals are caught before anything heavy is imported."""
    stop_on_signals()
    from jaxreplay.cli import main

    return main()


if __name__ == "__main__":
    sys.exit(main())
