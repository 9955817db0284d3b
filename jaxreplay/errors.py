"""The error raised for a user's mistakes, and suggestions for misspelt names."""

import difflib
from collections.abc import Iterable


class ConfigError(ValueError):
    """A user's mistake; the message is one line that names the place, the fault and the remedy."""


def suggest(name: str, known: Iterable[str]) -> str:
    """Return `name`, the closest of the known names if one is close, and all of them.

    For example: `"theta_j; did you mean theta_i? (known: theta_i, theta_tau)"`.
    """
    known = list(known)
    near = difflib.get_close_matches(name, known, n=1)
    hint = f"; did you mean {near[0]}?" if near else ""
    return f"{name}{hint} (known: {', '.join(known)})"
