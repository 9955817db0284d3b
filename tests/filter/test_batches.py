"""Steps jitted, vmapped over replays, and compiled no more than once."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from filter_helpers import own_tau_first, passing
from random_helpers import N_SENSORS, random_sequences

from jaxreplay import Params, Records, build_filter

SIGMA = np.array([0.5, 2.0])


def one_step(f, records, params, belief, z):
    belief = f.predict(records, params, belief)
    u = f.command(records, belief)
    belief, log_evidence = f.update(records, params, belief, z)
    return belief, (f.posterior(records, belief), u, log_evidence)


@cache
def batched_step(jump):
    """A step jitted and vmapped over params, belief and z, and the list of its compilations."""
    f, compilations = build_filter(jump), []

    def step(*replays):
        compilations.append(1)
        return jax.vmap(partial(one_step, f), in_axes=(None, 0, 0, 0))(*replays)

    return jax.jit(step), compilations


def assert_close(got, want):
    for a, b in zip(got, want, strict=True):
        np.testing.assert_allclose(a, b, atol=2e-6, rtol=1e-5)


@own_tau_first
def test_a_batch_of_replays_is_the_same_as_each_alone(jump):
    sequences = random_sequences(1)
    zs = passing(sequences[0][0], SIGMA, 9)
    records, f = Records.from_sequences(*sequences), build_filter(jump)
    batch = Params([0.0, 0.1, 1.0], [0.05, 0.0, 0.5], np.outer([0.5, 1, 2], SIGMA))
    rows = [Params(*values) for values in zip(*jax.tree.leaves(batch), strict=True)]
    alone = [f.init(records)] * 3
    together = jax.tree.map(lambda *beliefs: jnp.stack(beliefs), *alone)
    for z in zs.reshape(3, 3, N_SENSORS):
        together, got = batched_step(jump)[0](records, batch, together, z)
        pairs = [one_step(f, records, *replay) for replay in zip(rows, alone, z, strict=True)]
        alone = [belief for belief, _ in pairs]
        want = zip(*(seen for _, seen in pairs), strict=True)
        assert_close(got, [np.stack(values) for values in want])


@pytest.mark.slow
@own_tau_first
def test_steps_are_the_same_without_jit(jump):
    sequences = random_sequences(1)
    zs = passing(sequences[0][0], SIGMA, 9)
    records, f = Records.from_sequences(*sequences), build_filter(jump)
    params = Params(0.1, 0.05, SIGMA)
    jitted = belief = f.init(records)
    for z in zs[:1]:
        jitted, want = one_step(f, records, params, jitted, z)
        with jax.disable_jit():
            belief, got = one_step(f, records, params, belief, z)
        assert_close(got, want)


@own_tau_first
def test_new_values_compile_nothing_new(jump):
    f, (step, compilations) = build_filter(jump), batched_step(jump)
    for seed, theta in enumerate([0.1, 0, np.float64(0.5)]):
        records = Records.from_sequences(*random_sequences(seed, (200, 1 + seed, 7, 200)))
        params = Params([theta] * 3, [theta / 2] * 3, np.full((3, N_SENSORS), 1 + seed))
        belief = jax.tree.map(lambda leaf: jnp.stack([leaf] * 3), f.init(records))
        for z in (jnp.ones((3, N_SENSORS)), seed * np.ones((3, N_SENSORS))):
            belief, _ = step(records, params, belief, z)
    assert len(compilations) == 1
