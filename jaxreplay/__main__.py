"""The command `jaxreplay`, also as `python -m jaxreplay`."""

import os
import sys

from jaxreplay.cli.stop import stop_on_signals


def main() -> int:
    """Run the command line; signals are caught before anything heavy is imported."""
    _open_streams()
    stop_on_signals()
    from jaxreplay.cli import main

    return main()


def _open_streams() -> None:
    """Open those of stdin, stdout and stderr that are closed, so that no file takes their place."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free
            setattr(sys, name, os.fdopen(opened, "r" if number == 0 else "w"))


if __name__ == "__main__":
    sys.exit(main())
