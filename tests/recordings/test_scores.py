import dataclasses

import jax
import numpy as np
import pytest
from filter_helpers import own_tau_first
from recordings_helpers import GRID, TUNED_LENGTHS, expected, far_from_zero

from jaxreplay import Records, reference
from jaxreplay.recordings.scores import default_params, leave_one_out, leave_out, sensor_span


@own_tau_first
def test_scores_are_the_references(sequences, records, jump):
    scores = leave_one_out(records, GRID, jump)
    assert scores.steps.tolist() == list(TUNED_LENGTHS)
    for p in range(5):
        thetas = float(GRID.theta_i[p]), float(GRID.theta_tau[p])
        params = reference.Params(*thetas, np.asarray(GRID.sigma[p], float))
        each = [expected(sequences, i, params, jump) for i in range(3)]
        for i, (evidence, squares) in enumerate(each):
            assert scores.log_evidence_each[p, i] == pytest.approx(
                evidence / TUNED_LENGTHS[i], rel=1e-4
            )
            error = np.sqrt(squares.mean())
            assert scores.command_error_each[p, i] == pytest.approx(error, rel=1e-4)
        evidence = sum(evidence for evidence, _ in each) / sum(TUNED_LENGTHS)
        error = np.sqrt(np.concatenate([squares for _, squares in each]).mean())
        assert scores.log_evidence[p] == pytest.approx(evidence, rel=1e-4)
        assert scores.command_error[p] == pytest.approx(error, rel=1e-4)


def test_some_records_may_be_left_out(records):
    progress = []
    some = leave_one_out(records, GRID, "own_tau", [2, 0], lambda *n: progress.append(n))
    every = leave_one_out(records, GRID, "own_tau")
    assert some.steps.tolist() == [44, 60]
    np.testing.assert_array_equal(some.log_evidence_each, every.log_evidence_each[:, [2, 0]])
    assert max(progress) == (104, 104)


def test_what_is_left_out_leaves_no_trace(records):
    """No value of the record left out, first or last, is in what remains of the others."""
    changed = dataclasses.replace(
        records, nodes=records.nodes.at[:, 1].mul(7), commands=records.commands.at[:, 1].add(3)
    )
    for ours, theirs in zip(
        jax.tree.leaves(leave_out(records, 1)),
        jax.tree.leaves(leave_out(changed, 1)),
        strict=True,
    ):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize(("n", "i"), [(1, 0), (3, 3), (3, -1)])
def test_what_cannot_be_left_out_is_refused(records, n, i):
    with pytest.raises(ValueError, match="cannot be left out" if n == 1 else "no record"):
        leave_out(records.subset(range(n)), i)


def test_scores_do_not_depend_on_the_records_offset(sequences, records):
    far = Records.from_sequences(*far_from_zero(sequences))
    assert all(far.offset)
    assert not any(records.offset)
    want, scores = (leave_one_out(r, GRID, "own_tau") for r in (records, far))
    for a, b in zip(scores, want, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-4)
    np.testing.assert_allclose(sensor_span(far), sensor_span(records), rtol=1e-6)


def test_default_params_follow_from_the_records(records):
    params = default_params(records)
    assert float(params.theta_i) == pytest.approx(0.1)
    assert float(params.theta_tau) == pytest.approx(0.05)
    values = np.concatenate(records.sequences()[0])
    np.testing.assert_allclose(params.sigma, 0.1 * np.ptp(values, axis=0), rtol=1e-6)
