"""Time-indexed Gaussian mixture regression."""

from typing import NamedTuple

import numpy as np
from gmr import GMM
from gmr.mvn import regression_coefficients
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

_COMPONENTS = (10, 20, 40)
_WINDOWS = (1.0, 5.0)  # s
_PRINCIPAL = 4  # most principal components of the recent observations
_SAMPLES = 3000  # rows to which a mixture is fitted, about
_ROWS_EACH = 10  # fewest rows for each Gaussian
_ITERATIONS = 30
# Standard deviation, in units of each value's own, of noise added to the samples. Commands that
# are constant in a part of all records would have singular covariances.
_NOISE = 0.03


class Settings(NamedTuple):
    """What is chosen on the records: the number of Gaussians, and the window in rows."""

    components: int
    window: int


class Regression(FromRecent):
    """Send the command that a Gaussian mixture expects at this time and observation.

    It stands for Gaussian mixture regression (Calinon et al. 2007), with the library `gmr`. The
    mixture is over progress t / L, the principal components (up to 4) of a window of recent
    observations and the next command, each scaled to variance 1. The window and the number of
    Gaussians are those with the least absolute error of commands on every fourth record, predicted
    from the others. Progress advances by 1 / median length per step, whatever is observed; it ends
    at 1.

    Attributes:
        settings: what was chosen.
    """

    def __init__(self, records: Records, params: Params, options: Options):
        """Begin B replays; of `[B]`-batched params only B is used, of options `last_steps`."""
        rows = rows_of(records, options.counted)
        self.settings, self._principal, self._mixture = _fit(rows)
        super().__init__(rows, len(params.theta_i), self.settings.window)
        self._median = np.median(np.asarray(records.lengths))

    def observe(self, z: np.ndarray, which: np.ndarray) -> Observed:
        """Advance progress in the slots `which`, and predict their next commands."""
        self._recent.add(z, which)
        progress = self._recent.steps / self._median
        seen = self._principal(described(self._recent.window))
        expected = self._mixture(np.column_stack([progress, seen]))
        self.command[which] = self._rows.within(expected)[which]
        return Observed((progress >= 1).astype(float))


class _Principal:
    """Principal components, up to 4, of inputs `[R, n]`."""

    def __init__(self, inputs: np.ndarray):
        self._centre = inputs.mean(axis=0)
        _, size, axes = np.linalg.svd(inputs - self._centre, full_matrices=False)
        kept = max(int((size > 1e-6 * max(size[0], 1e-12)).sum()), 1)
        self._axes = axes[: min(kept, _PRINCIPAL)].T

    def __call__(self, inputs: np.ndarray) -> np.ndarray:
        """Return those of inputs `[B, n]`, each row's alone: rounding must not depend on B."""
        return ((inputs - self._centre)[:, None] @ self._axes)[:, 0]


class _Mixture:
    """A Gaussian mixture over inputs and outputs, all scaled to variance 1."""

    def __init__(self, x: np.ndarray, y: np.ndarray, components: int):
        """Fit it to inputs `[R, n]` and outputs `[R, m]`; with half as many if it degenerates."""
        both = np.column_stack([x, y])
        self._mean, self._spread = both.mean(axis=0), spread_of(both)
        samples = ((both - self._mean) / self._spread)[:: max(len(both) // _SAMPLES, 1)]
        samples += _NOISE * np.random.default_rng(0).standard_normal(samples.shape)
        self._n = n = x.shape[1]
        priors, self._means, covariances = _fitted(
            samples, min(components, len(samples) // _ROWS_EACH)
        )
        inner, outer = np.arange(n), np.arange(n, samples.shape[1])
        self._slopes = np.stack([regression_coefficients(c, outer, inner).T for c in covariances])
        # log p(x, k) = level_k − |(x − mean_k) root_k|² / 2, less a constant.
        self._roots = np.linalg.cholesky(np.linalg.inv(covariances[:, :n, :n]))
        volume = np.log(np.diagonal(self._roots, axis1=1, axis2=2)).sum(axis=1)
        self._level = np.log(priors) + volume

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Return the expected outputs `[B, m]` at inputs `[B, n]`, E[y | x] = Σ_k p(k | x) E_k.

        Each row is multiplied alone: in a common product, rounding depends on B.
        """
        n = self._n
        scaled = (x - self._mean[:n]) / self._spread[:n]
        away = (scaled[:, None] - self._means[:, :n])[:, :, None]  # [B, K, 1, n]
        log_p = self._level - ((away @ self._roots)[:, :, 0] ** 2).sum(axis=-1) / 2
        p = np.exp(log_p - log_p.max(axis=1, keepdims=True))
        p /= p.sum(axis=1, keepdims=True)
        each = self._means[:, n:] + (away @ self._slopes)[:, :, 0]
        return (p[:, :, None] * each).sum(axis=1) * self._spread[n:] + self._mean[n:]


def _fitted(samples: np.ndarray, components: int) -> tuple[np.ndarray, ...]:
    """Return priors `[K]`, means `[K, n + m]` and covariances of a mixture fitted to samples.

    All covariances are regular: K is halved until they are.

    Args:
        samples: `[R, n + m]`.
        components: K at first.
    """
    while True:
        model = GMM(max(components, 1), random_state=0)
        try:
            with np.errstate(all="ignore"):  # an empty Gaussian divides by 0
                model.from_samples(
                    samples,
                    n_iter=_ITERATIONS,
                    init_params="kmeans++",
                    oracle_approximating_shrinkage=True,
                )
                fitted = tuple(map(np.asarray, (model.priors, model.means, model.covariances)))
                np.linalg.cholesky(fitted[2])
            if all(np.isfinite(values).all() for values in fitted):
                return fitted
            raise ValueError("a Gaussian without samples")
        except (ValueError, np.linalg.LinAlgError):  # not finite, or singular
            if components <= 1:
                raise
            components //= 2


@remembered
@threadpool_limits.wrap(limits=1)  # on small matrices more threads only wait for each other
def _fit(rows: Rows) -> tuple[Settings, _Principal, _Mixture]:
    """Return the settings, and what is fitted with them."""
    settings = _choose(rows)
    inputs = described(windows(rows.seen, settings.window))
    principal = _Principal(inputs)
    inputs = np.column_stack([rows.progress, principal(inputs)])
    return settings, principal, _Mixture(inputs, rows.command, settings.components)


def _choose(rows: Rows) -> Settings:
    """Return the settings with the least error of commands; the first if N < 4."""
    lengths = rows.lasting(_WINDOWS)
    numbers = sorted({min(n, len(rows.row) // _ROWS_EACH) for n in _COMPONENTS})
    if not (apart := rows.apart).any():
        return Settings(numbers[0], lengths[0])
    errors: dict[Settings, float] = {}
    for length in lengths:
        inputs = described(windows(rows.seen, length))
        inputs = np.column_stack([rows.progress, _Principal(inputs)(inputs)])
        for components in numbers:
            mixture = _Mixture(inputs[~apart], rows.command[~apart], components)
            error = command_error(
                mixture(inputs[apart]), rows.command[apart], spread_of(rows.command)
            )
            errors[Settings(components, length)] = float(error.mean())
    return min(errors, key=lambda settings: errors[settings])
