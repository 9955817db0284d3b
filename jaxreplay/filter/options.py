"""What is chosen for a replay besides the parameters: reading of a jump, start, and end."""

from typing import Any, Literal, NamedTuple

import numpy as np

from jaxreplay.filter.belief import DEFAULT_JUMP, READINGS, Jump

Start = Literal["first", "anywhere"]
STARTS: tuple[Start, ...] = ("first", "anywhere")
LAST_STEPS = 10  # § 2.2.5


class Options(NamedTuple):
    """Choices that are the same for all replays of a batch.

    Attributes:
        jump: the reading of a jump, `"same_tau"` or `"own_tau"`.
        start: where a replay starts: `"first"`, at each record's first sample (equation 5), or
            `"anywhere"`, at any sample with equal probability.
        last_steps: samples at a record's end that count as its end; the paper's are 10. None: the
            environment alone ends a replay, and the end probability is that of the last sample.
    """

    jump: Jump = DEFAULT_JUMP
    start: Start = "first"
    last_steps: int | None = LAST_STEPS

    @property
    def counted(self) -> int:
        """Samples at a record's end that the end probability is of."""
        return self.last_steps or 1


def options_of(jump: Any, start: Any = "first", last_steps: Any = LAST_STEPS) -> Options:
    """Return checked options.

    Raises:
        ValueError: one has no such value.
    """
    if jump not in READINGS:
        raise ValueError(f"jump must be one of {', '.join(READINGS)}; got {jump!r}")
    if start not in STARTS:
        raise ValueError(f"start must be one of {', '.join(STARTS)}; got {start!r}")
    whole = isinstance(last_steps, int | np.integer) and not isinstance(last_steps, bool)
    if last_steps is not None and not (whole and last_steps >= 0):
        raise ValueError(
            f"last_steps must be a whole number, or None (or 0) where the environment alone ends a "
            f"replay; got {last_steps!r}"
        )
    return Options(jump, start, int(last_steps) if last_steps else None)
