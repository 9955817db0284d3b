"""Behaviour cloning: a small network from recent observations to the next command."""

import warnings

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPRegressor
from threadpoolctl import threadpool_limits

from jaxreplay.filter.options import Options
from jaxreplay.loop.controller import Observed
from jaxreplay.loop.rivals.slots import (
    FromRecent,
    Rows,
    command_error,
    described,
    remembered,
    rows_of,
    spread_of,
    windows,
)
from jaxreplay.params import Params
from jaxreplay.records import Records

_WINDOWS = (1.0, 5.0)  # s
_HIDDEN = (64, 64)
_NETWORKS = 3  # whose mean is sent; they differ in their first weights


class Cloning(FromRecent):
    """Send the command that a multilayer perceptron predicts from recent observations.

    It stands for behaviour cloning (Pomerleau 1989), as in the project `imitation`, with
    scikit-learn's network; the mean of three such networks is sent. Inputs are a window of recent
    observations, described by means of its parts, and progress t / L, for which a replay takes its
    time as a share of the median record, at most 1. Outputs are the next command and t / L. The
    window is the one with the least absolute error of commands on every fourth record, predicted
    from the others. It ends when for one second the predicted progress has exceeded
    1 − 10 (or `last_steps`) / mean length.

    Attributes:
        window: rows of recent observations, as chosen.
    """

    def __init__(self, records: Records, params: Params, options: Options):
        """Begin B replays; of `[B]`-batched params only B is used, of options `last_steps`."""
        rows = rows_of(records, options.counted)
        lengths = np.asarray(records.lengths)
        self.window, self._network = _fit(rows)
        super().__init__(rows, len(params.theta_i), self.window)
        self._median, self._end = np.median(lengths), 1 - rows.last / lengths.mean()

    def observe(self, z: np.ndarray, which: np.ndarray) -> Observed:
        """Predict the next commands and the progress of the slots `which`."""
        self._recent.add(z, which)
        elapsed = np.minimum(self._recent.steps / self._median, 1)
        predicted = self._network(np.column_stack([described(self._recent.window), elapsed]))
        self.command[which] = self._rows.within(predicted[:, :-1])[which]
        return Observed(self._at_end.add(predicted[:, -1] > self._end, which).astype(float))


class _Network:
    """The mean of some multilayer perceptrons; inputs and outputs are scaled to variance 1."""

    def __init__(self, x: np.ndarray, y: np.ndarray, networks: int):
        """Fit outputs `[R, m]` to inputs `[R, n]`."""
        self._mean, self._spread = x.mean(axis=0), spread_of(x)
        self._out_mean, self._out_spread = y.mean(axis=0), spread_of(y)
        x, y = (x - self._mean) / self._spread, (y - self._out_mean) / self._out_spread
        self._models = [_layers(x, y, seed) for seed in range(networks)]

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Return outputs `[B, m]` for inputs `[B, n]`.

        Each row is multiplied alone: in a common product, rounding depends on B.
        """
        total = 0.0
        for *hidden, (weights, bias) in self._models:
            y = ((x - self._mean) / self._spread)[:, None]
            for inner, shift in hidden:
                y = np.maximum(y @ inner + shift, 0)
            total = total + (y @ weights + bias)[:, 0]
        return total / len(self._models) * self._out_spread + self._out_mean


def _layers(x: np.ndarray, y: np.ndarray, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return weights and biases of a network fitted to scaled outputs at scaled inputs."""
    model = MLPRegressor(
        hidden_layer_sizes=_HIDDEN,
        early_stopping=len(x) >= 100,  # a tenth of fewer rows says nothing
        n_iter_no_change=10,
        max_iter=100,
        random_state=seed,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        model.fit(x, y)
    return list(zip(model.coefs_, model.intercepts_, strict=True))


@remembered
@threadpool_limits.wrap(limits=1)  # on small matrices more threads only wait for each other
def _fit(rows: Rows) -> tuple[int, _Network]:
    """Return the window in rows, and the network for it."""
    window = _window(rows)
    return window, _Network(_inputs(rows, window), _outputs(rows), _NETWORKS)


def _inputs(rows: Rows, window: int) -> np.ndarray:
    return np.column_stack([described(windows(rows.seen, window)), rows.progress])


def _outputs(rows: Rows) -> np.ndarray:
    return np.column_stack([rows.command, rows.progress])


def _window(rows: Rows) -> int:
    """Return the window in rows with the least error of commands; the first if N < 4."""
    lengths = rows.lasting(_WINDOWS)
    if not (apart := rows.apart).any():
        return lengths[0]
    outputs, spread = _outputs(rows), spread_of(rows.command)

    def error(length: int) -> float:
        inputs = _inputs(rows, length)
        predicted = _Network(inputs[~apart], outputs[~apart], 1)(inputs[apart])[:, :-1]
        return float(command_error(predicted, rows.command[apart], spread).mean())

    return min(lengths, key=error)
