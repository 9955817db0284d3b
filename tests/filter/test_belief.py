"""A belief knows its reading of a jump by name; the shapes of its arrays do not matter."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from filter_helpers import both_readings
from random_helpers import random_sequences

from jaxreplay import Params, Records, build_filter, reference
from jaxreplay.filter import READINGS, init, predict
from jaxreplay.filter.numerics.scaled import scaled

PARAMS = reference.Params(0.25, 0.0625, np.array([0.5, 2.0]))
LENGTHS = (9, 7)


@pytest.mark.parametrize("start", [np.int32(0), np.zeros(2, np.int32)], ids=["scalar", "[N]"])
@both_readings
def test_the_reading_is_the_name_whatever_the_rank_of_start(jump, start):
    sensors, commands = random_sequences(0, LENGTHS)
    records = Records.from_sequences(sensors, commands)
    p = np.random.default_rng(1).random((2, 9)) * (np.arange(9) < np.array(LENGTHS)[:, None])
    p /= p.sum()
    belief = dataclasses.replace(
        init(records, jump), p=scaled(jnp.asarray(p, "float32")), start=jnp.asarray(start)
    )
    with np.errstate(divide="ignore"):
        want = {name: reference.predict(sensors, PARAMS, np.log(p), name) for name in READINGS}
    assert np.abs(np.exp(want["same_tau"]) - np.exp(want["own_tau"])).max() > 0.01
    predicted = build_filter(jump).predict(records, Params(*PARAMS), belief)
    assert predicted.jump == jump
    np.testing.assert_allclose(predicted.p.value(), np.exp(want[jump]), atol=1e-6)


def test_a_belief_of_another_filter_is_refused():
    records = Records.from_sequences(*random_sequences(0, (90, 80)))
    params, z = Params(*PARAMS), np.zeros(records.n_sensors)
    mine = build_filter("own_tau", 40)
    for other in (
        build_filter("same_tau", 40),
        build_filter("own_tau"),
        build_filter("own_tau", 50),
    ):
        belief = other.init(records)
        with pytest.raises(ValueError, match=r"build_filter\('own_tau', 40\)"):
            mine.predict(records, params, belief)
        with pytest.raises(ValueError, match=r"build_filter\('own_tau', 40\)"):
            mine.update(records, params, belief, z)
    whole = build_filter("own_tau", 200)  # wider than the records: all samples
    assert whole.predict(records, params, build_filter("own_tau").init(records)).window is None


@both_readings
def test_with_one_record_too_the_reading_is_the_name(jump):
    """Of a belief that sums to ½, `same_tau` renormalises the whole, `own_tau` each record."""
    records = Records.from_sequences(*random_sequences(0, (9,)))
    belief = init(records, jump)
    belief = dataclasses.replace(belief, p=scaled(belief.p.value() / 2), start=jnp.int32(0))
    predicted = predict(records, Params(*PARAMS), belief)
    assert predicted.jump == jump
    assert np.sum(predicted.p.value()) == (1.0 if jump == "same_tau" else 0.5)


@both_readings
@pytest.mark.parametrize("window", [None, 32])
def test_steps_keep_the_reading_and_the_window(jump, window):
    records = Records.from_sequences(*random_sequences(0, (40, 1)))
    f = build_filter(jump, window)
    belief = f.init(records)
    assert (belief.jump, belief.window) == (jump, window)
    assert belief.start.shape == (() if jump == "same_tau" else (2,))
    belief = f.predict(records, Params(*PARAMS), belief)
    belief, _ = f.update(records, Params(*PARAMS), belief, np.zeros(2))
    assert (belief.jump, belief.window) == (jump, window)
