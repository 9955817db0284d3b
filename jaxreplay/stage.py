"""How the equations are cut into pieces for XLA."""

from collections.abc import Callable
from functools import wraps

import jax
from jax.experimental.xla_metadata import set_xla_metadata


def stage(function: Callable) -> Callable:
    """The function as a stage of its own in the compiled program, its results stored once.

    Left to itself XLA on CPU fuses a filter step into few loops and computes a value again at
    every use, several times the work. Within the stage it may fuse as it likes.
    """

    @jax.jit
    def body(*args):
        with set_xla_metadata(inlineable=None):
            return function(*args)

    @wraps(function)
    def call(*args):
        with set_xla_metadata(inlineable="false"):
            return body(*args)

    return call
