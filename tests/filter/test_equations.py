"""Each equation of the paper, as printed, against both implementations: NumPy's and JAX's.

What is expected is computed here from the paper alone, in plain probabilities and loops, with
nothing of the package. Equation 1, of which equation 9 is the recursion, is summed over all paths
in `test_reference.py`.
"""

from collections import Counter
from contextlib import ExitStack
from functools import cache
from itertools import pairwise
from math import exp, isnan, log, pi, sqrt
from typing import NamedTuple

import jax
import numpy as np
import pytest
from filter_adapters import InJax, InNumPy
from filter_helpers import both_readings, x64
from random_helpers import as_float32
from scipy.integrate import quad

COMMANDS = ((-1.0, 0.0), (0.0, 0.5), (1.0, 1.0))  # each made at several samples


class Case(NamedTuple):
    """Records, an observation and parameters; all values are exact in float32."""

    sensors: list[np.ndarray]
    z: np.ndarray
    theta_i: float = 0.125
    theta_tau: float = 0.0625
    sigma: tuple[float, float] = (0.5, 2.0)

    @property
    def states(self):
        return [(i, j) for i, record in enumerate(self.sensors) for j in range(len(record))]

    @property
    def commands(self):
        """v[i][j]."""
        rows = [
            [COMMANDS[(i + j * j) % 3] for j in range(len(s))] for i, s in enumerate(self.sensors)
        ]
        return [np.array(row) for row in rows]

    @property
    def belief(self):
        """p[i, j]: in every record, and 0 at some of its samples."""
        p = self.empty()
        for i, j in self.states:
            p[i, j] = (3 * i + 7 * j) % 5 + (j == 0)
        return p / p.sum()

    def empty(self):
        return np.zeros((len(self.sensors), max(map(len, self.sensors))))


def walk(*lengths):
    rng = np.random.default_rng(lengths)
    return [as_float32(0.5 * rng.normal(size=(n, 2)).cumsum(0)) for n in lengths]


def standstill():
    """A walk with two equal samples, and then two that differ in one sensor only."""
    records = walk(13, 4)
    records[0][3] = records[0][2]
    records[0][6, 1] = records[0][5, 1]
    return records


def strides():
    """Records that cross some 90 % of a range of 100 σ between any two samples."""
    at = np.array([5, 95, 0, 90, 10, 100, 5, 95, 0, 90, 10, 100, 5])
    return [at[:, None] * np.array([0.5, 2.0]), at[1:5, None] * np.array([0.5, 2.0])]


Z = np.array([0.25, -0.75])
CASES = {  # of few shapes, since JAX compiles for each
    "two records": Case(walk(13, 4), Z),
    "three records": Case(walk(7, 13, 11), Z),
    "one record": Case(walk(13), Z),
    "one record of one sample": Case(walk(1), Z),
    "a record of one sample": Case(walk(1, 13), Z),
    "equal consecutive samples": Case(standstill(), Z),
    "an observation equal to two samples": Case(standstill(), standstill()[0][2]),
    "segments of 90 % of the range": Case(strides(), np.array([22.5, 95.0])),
    "a missing sensor": Case(walk(13, 4), np.array([np.nan, -0.75])),
    "no sensor but missing ones": Case(walk(13, 4), np.full(2, np.nan)),
    "θ_I = 0": Case(walk(7, 13, 11), Z, theta_i=0.0),
    "θ_I = 1": Case(walk(7, 13, 11), Z, theta_i=1.0),
    "θ_τ = 0": Case(walk(13, 4), Z, theta_tau=0.0),
    "θ_τ = ½": Case(walk(13, 4), Z, theta_tau=0.5),
}
every_case = pytest.mark.parametrize("name", CASES)


@pytest.fixture(
    params=[
        pytest.param(InNumPy(), id="numpy"),
        pytest.param(InJax("float32"), id="float32"),
        pytest.param(InJax("float64"), id="float64", marks=pytest.mark.slow),
        pytest.param(InJax("float32", jit=False), id="float32-without-jit", marks=pytest.mark.slow),
    ]
)
def model(request):
    with ExitStack() as stack:
        if isinstance(request.param, InJax):
            stack.enter_context(x64(request.param.precision))
            if not request.param.jit:
                stack.enter_context(jax.disable_jit())
        yield request.param


def assert_equal(model, got, want):
    if isinstance(got, jax.Array):
        assert got.dtype == model.precision
    np.testing.assert_allclose(got, want, rtol=model.tolerance, atol=1e-3 * model.tolerance)


def normal(x, sigma):
    return exp(-((x / sigma) ** 2) / 2) / (sigma * sqrt(2 * pi))


@cache
def half(z, a, b, sigma):
    """One of the two integrals of equation 2; their limit where its segment has no length."""
    if a == b:
        return normal(z - a, sigma) / 2
    near = (z + side * sigma * 2.0**k for side in (-1, 1) for k in range(-2, 8))
    cuts = sorted({a, b, *(t for t in (z, *near) if min(a, b) < t < max(a, b))}, reverse=b < a)
    return sum(
        quad(lambda t: normal(z - t, sigma) / (2 * (b - a)), *piece, epsabs=0, epsrel=1e-11)[0]
        for piece in pairwise(cuts)
    )


def equation_2(case):
    """p(Z_t | I_t = i, τ_t = j); an end of a record counts its only segment twice."""
    p = case.empty()
    for i, j in case.states:
        record, p[i, j] = case.sensors[i], 1.0
        for k, sigma in enumerate(case.sigma):
            zeta = [float(sample[k]) for sample in record]
            before = (zeta[j - 1], zeta[j]) if j > 0 else None
            after = (zeta[j], zeta[j + 1]) if j + 1 < len(record) else None
            before, after = before or after, after or before
            if not isnan(case.z[k]):
                segments = (before, after) if before else ((zeta[j], zeta[j]),) * 2
                p[i, j] *= sum(half(float(case.z[k]), *segment, sigma) for segment in segments)
    return p


def equation_3(case, i, i_before):
    n = len(case.sensors)
    if n == 1:
        return 1.0
    return 1 - case.theta_i if i == i_before else case.theta_i / (n - 1)


def equation_4(case, j, j_before, length):
    """p(τ_t = j | τ_{t−1}) in a record whose last sample absorbs what would pass it."""
    steps = {0: case.theta_tau, 1: 1 - 2 * case.theta_tau, 2: case.theta_tau}
    return sum(p for step, p in steps.items() if min(j_before + step, length - 1) == j)


@every_case
def test_equation_2(name, model):
    case = CASES[name]
    assert_equal(model, model.likelihood(case), equation_2(case))


@every_case
def test_equation_3(name, model):
    case = CASES[name]
    n = len(case.sensors)
    matrix = [[equation_3(case, i, i_before) for i_before in range(n)] for i in range(n)]
    assert_equal(model, model.record_transition(case, np.eye(n)), matrix)


@every_case
def test_equation_4(name, model):
    case = CASES[name]
    for j_before in range(case.empty().shape[1]):
        starts, column = case.empty(), case.empty()
        for i, record in enumerate(case.sensors):
            if j_before < len(record):
                starts[i, j_before] = 1.0
                for j in range(len(record)):
                    column[i, j] = equation_4(case, j, j_before, len(record))
        assert_equal(model, model.time_transition(case, starts), column)


@both_readings
@every_case
def test_equation_5(name, model, jump):
    case = CASES[name]
    want = case.empty()
    for i, j in case.states:
        want[i, j] = 1 / len(case.sensors) if j == 0 else 0.0
    assert_equal(model, model.init(case, jump), want)


@every_case
def test_equation_6_same_tau(name, model):
    case = CASES[name]
    p, want = case.belief, case.empty()
    for i, j in case.states:
        for i_before, j_before in case.states:
            of_record = equation_3(case, i, i_before)
            of_time = equation_4(case, j, j_before, len(case.sensors[i_before]))
            want[i, j] += of_record * of_time * p[i_before, j_before]
    # What the sum gives to moments past a record's end is not among the states.
    assert_equal(model, model.predict(case, p, "same_tau"), want / want.sum())


@every_case
def test_equation_6_own_tau(name, model):
    case = CASES[name]
    p, want = case.belief, case.empty()
    for i, j in case.states:
        length = len(case.sensors[i])
        of_record = sum(equation_3(case, i, of) * p[of].sum() for of in range(len(p)))
        of_time = sum(
            equation_4(case, j, of, length) * p[i, of] / p[i].sum() for of in range(length)
        )
        want[i, j] = of_record * of_time
    assert_equal(model, model.predict(case, p, "own_tau"), want)


@every_case
def test_equation_7(name, model):
    """The probability of each distinct command: the expectation of its indicator."""
    case = CASES[name]
    p, probability = case.belief, Counter()
    for i, j in case.states:
        probability[tuple(case.commands[i][j])] += p[i, j]
    indicators = [(v[:, None] == np.array(COMMANDS)).all(2).astype(float) for v in case.commands]
    got = model.command(case, indicators, p)
    assert_equal(model, got, [probability[command] for command in COMMANDS])
    assert np.sum(got) == pytest.approx(1, rel=model.tolerance)


@every_case
def test_equation_8(name, model):
    case = CASES[name]
    p, want = case.belief, np.zeros(2)
    for i, j in case.states:
        want += case.commands[i][j] * p[i, j]
    assert_equal(model, model.command(case, case.commands, p), want)


@every_case
def test_equation_9(name, model):
    case = CASES[name]
    joint, seen = case.belief, equation_2(case)
    for i, j in case.states:
        joint[i, j] *= seen[i, j]
    got, log_evidence = model.update(case, case.belief)
    assert_equal(model, got, joint / joint.sum())
    assert log_evidence == pytest.approx(log(joint.sum()), rel=model.tolerance, abs=model.tolerance)


@every_case
def test_section_2_2_5(name, model):
    case = CASES[name]
    p = case.belief
    want = sum(p[i, j] for i, j in case.states if j >= len(case.sensors[i]) - 10)
    assert_equal(model, model.end_probability(case, p), want)
