"""That other versions of the filter compute its equations: they are compared with it in speed."""

import ast
import sys
from pathlib import Path

import numpy as np
import pytest

from jaxreplay import reference

sys.path.append(str(Path(__file__).parents[1] / "experiments" / "benchmarks"))

import numpy_rival
from filter_helpers import both_readings
from work import errors, first_prediction, make_work, reference_beliefs

ROOT = Path(__file__).parents[1]
EQUATIONS = {  # 2 and its integral, 3, 4, 6 in both readings, 8, 9 and § 2.2.5
    "segment_mean", "likelihood", "record_transition", "time_transition", "predict_same_tau",
    "predict_own_tau", "command", "update", "end_probability",
}  # fmt: skip


@pytest.mark.parametrize(
    "version",
    [
        "jaxreplay/reference.py",
        "jaxreplay/filter/**/*.py",
        "experiments/plain_filter.py",
        "experiments/benchmarks/numpy_rival.py",
        "experiments/benchmarks/numba_rival.py",
    ],
)
def test_every_version_of_the_filter_has_an_equation_under_one_name(version):
    bodies = [ast.parse(path.read_text()).body for path in ROOT.glob(version)]
    functions = {f.name: f for body in bodies for f in body if isinstance(f, ast.FunctionDef)}
    if {"short_mean", "long_mean"} <= functions.keys():  # the integral in two forms
        functions["segment_mean"] = functions["short_mean"]
    assert functions.keys() >= EQUATIONS
    for name in EQUATIONS - {"segment_mean", "end_probability"}:
        assert "quation" in ast.get_docstring(functions[name])


@both_readings
def test_the_numpy_rival_computes_the_equations_of_the_reference(jump):
    work = make_work(jump, n=3, length=40, replays=1, steps=20)
    work.sensors[1, 5:8] = work.sensors[1, 5]  # segments of no length
    sensors, commands = list(work.sensors), list(work.commands)
    params = reference.Params(0.01, 0.05, np.full(7, 0.1))
    records = numpy_rival.records_of(work.sensors, work.commands, params)
    belief, wanted = first_prediction(work), reference.init(sensors)
    spare, memory = np.empty_like(belief), numpy_rival.memory_for(records)
    wanted = reference.predict(sensors, params, wanted, jump)
    for z in work.observations[:, 0]:
        got = numpy_rival.likelihood(records, params, z, spare, memory)
        want = reference.likelihood(sensors, params, z)
        np.testing.assert_allclose(np.log(got) - 7 * np.log(4), want, rtol=1e-9)
        belief, evidence = numpy_rival.update(records, params, belief, z, spare, memory)
        wanted, want_evidence = reference.update(sensors, params, wanted, z)
        assert evidence == pytest.approx(want_evidence, rel=1e-9)
        want = reference.end_probability(sensors, wanted)
        assert numpy_rival.end_probability(belief) == pytest.approx(want, abs=1e-12)
        belief, spare = numpy_rival.predict(params, belief, jump, spare, memory), belief
        wanted = reference.predict(sensors, params, wanted, jump)
        np.testing.assert_allclose(belief, np.exp(wanted), atol=1e-12)
        command = numpy_rival.command(records, belief)
        np.testing.assert_allclose(command, reference.command(commands, wanted), atol=1e-9)


@pytest.mark.slow
@both_readings
def test_the_numba_rival_is_as_exact_as_float32_allows(jump):
    pytest.importorskip("numba")
    from rivals import numba_step

    work = make_work(jump, n=6, length=200, replays=1, steps=100)
    found = errors(numba_step(work, 1), work, list(reference_beliefs(work)))
    assert found["share"] <= 1
    assert found["command"] < 1e-5
