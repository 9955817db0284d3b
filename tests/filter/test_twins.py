"""`reference` and `filter` are twins: the same names, the same arguments in the same order."""

import inspect
import re

import pytest

from jaxreplay import filter as engine
from jaxreplay import reference
from jaxreplay.filter import observation, steps, transition

ORDER = ("records", "params", "belief", "z")  # what follows them is one implementation's own
SYNONYMS = {"sensors": "records", "commands": "records", "mass": "belief"}
PLACES = (observation, transition, steps)


def functions_of(module):
    """The public functions that a module defines itself."""
    members = inspect.getmembers(module, inspect.isfunction)
    return {
        name: function
        for name, function in members
        if function.__module__ == module.__name__ and not name.startswith("_")
    }


IN_NUMPY = functions_of(reference)
IN_JAX = {name: f for module in PLACES for name, f in functions_of(module).items()}
SHARED = sorted(set(IN_NUMPY) & set(IN_JAX))


def arguments(function):
    return [SYNONYMS.get(name, name) for name in inspect.signature(function).parameters]


def test_every_equation_has_one_name_in_both():
    assert set(IN_NUMPY) - set(IN_JAX) == {
        "segment_mean",  # in JAX it is relative to an anchor
        "filled",  # in JAX when the records are made
    }
    assert set(IN_JAX) - set(IN_NUMPY) == {"posterior"}  # in NumPy it is the belief itself
    assert SHARED == [
        "command",
        "end_probability",
        "init",
        "likelihood",
        "predict",
        "predict_own_tau",
        "predict_same_tau",
        "record_transition",
        "time_transition",
        "update",
    ]


@pytest.mark.parametrize("name", SHARED)
def test_arguments_are_the_same_in_one_order(name):
    numpy, jax = (arguments(functions[name]) for functions in (IN_NUMPY, IN_JAX))
    common = [argument for argument in numpy if argument in ORDER]
    assert common == sorted(common, key=ORDER.index)
    assert numpy[: len(common)] == common
    assert jax[: len(common)] == common
    assert not set(jax[len(common) :]) & set(ORDER)


@pytest.mark.parametrize("name", SHARED)
def test_both_name_the_same_place_in_the_paper(name):
    numpy, jax = (
        re.search(r"[Ee]quation (\d)|§ (2\.2\.5)", functions[name].__doc__).groups()
        for functions in (IN_NUMPY, IN_JAX)
    )
    assert numpy == jax


def test_constants_of_the_paper_are_the_same():
    assert steps.LAST_STEPS == reference.LAST_STEPS == 10


def test_the_table_of_equations_names_functions_that_exist():
    table = [line for line in engine.__doc__.splitlines() if line.startswith("|")]
    listed = re.findall(r"`(\w+)\.(\w+)`", "".join(table))
    assert {name for _, name in listed} == set(SHARED) - {"predict"}
    for module, name in listed:
        assert IN_JAX[name].__module__ == f"jaxreplay.filter.{module}"
