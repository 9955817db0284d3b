"""How the equations are cut into pieces for XLA."""

from collections.abc import Callable
from functools import wraps
from typing import TypeVar

import jax
from jax.experimental.xla_metadata import set_xla_metadata

Function = TypeVar("Function", bound=Callable)


def stage(function: Function) -> Function:
    """Return the function as a stage of its own in the compiled program: its results are stored.

    Otherwise XLA on CPU fuses a filter step into few loops and computes a value again at each of
    its uses, several times the work. Within a stage it may fuse as it likes.

    To be made once for a function: outside `jax.jit`, every stage is compiled anew.
    """

    @jax.jit
    def body(*args):
        with set_xla_metadata(inlineable=None):
            return function(*args)

    @wraps(function)
    def call(*args):
        with set_xla_metadata(inlineable="false"):
            return body(*args)

    return call  # pyright: ignore[reportReturnType]
