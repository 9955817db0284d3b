"""What does each sensor tell, and when? The information that it gives, over a run.

    python experiments/sensors.py [--seeds 10] [--set KEY=VALUE]… [--out results/sensors]

The paper's future work asks which sensors matter when. Here a sensor's information at a step is
what its value alone changes in the filter's belief about the record and the moment,

    D( p(I_t, τ_t | Z_1:t−1, z_k,t) ‖ p(I_t, τ_t | Z_1:t−1) )  in bits,

by equations 6 and 9 with all other sensors missing. Runs of `theta_i.toml` are done again with
several sets of demonstrations, one for each seed; a run is divided into twenty parts of equal
duration. Intervals are over sets (see `sets.py`). Whether a replay can do without a sensor is
another question: `sensors.toml` asks it.
"""

import argparse
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from pieces import done_again, padded
from sets import interval, number

from jaxreplay.filter import build_filter
from jaxreplay.machine import keep_compiled
from jaxreplay.params import Params
from jaxreplay.plane.params import SENSOR_NAMES
from jaxreplay.records import Records
from jaxreplay.study.config import load_config

STUDY = Path(__file__).with_name("theta_i.toml")
DEFAULTS = (
    "jump=own_tau",
    "axis.theta_i=[0.1]",
    "repeats=1",
    "positions.x.linspace=[0.26,0.39,2]",
    "positions.y.linspace=[-0.09,0.09,3]",
)
PARTS = 20
TOGETHER = ("proximeters", "all")  # besides each sensor alone


def main():
    """Run, print the table and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10, help="how many sets of demonstrations")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="as of `jaxreplay run`"
    )
    parser.add_argument("--out", type=Path, default=Path("results/sensors"))
    options = parser.parse_args()
    keep_compiled()
    options.out.mkdir(parents=True, exist_ok=True)
    each = []
    for seed in range(1, options.seeds + 1):
        each.append(of_set([*DEFAULTS, *options.set, f"seed={seed}"], options.out))
        print(f"{seed} of {options.seeds} sets", flush=True)
    bits = np.array(each)
    print(table(bits))
    for suffix in ("png", "pdf"):
        figure(bits, options.out / f"information.{suffix}")
    print(f"{options.out}: information.png and information.pdf")


def of_set(changes: list[str], out: Path) -> np.ndarray:
    """Return the mean bits a second over the runs with one set, `[n_s + 2, PARTS]`."""
    config = load_config(STUDY, changes)
    found = [
        in_parts(information(run.records, run.params, config.fixed["jump"], run.observations))
        for run in done_again(config, out)
    ]
    return np.mean(found, axis=0) / config.world.step


def information(records: Records, params: Params, jump: str, seen: np.ndarray) -> np.ndarray:
    """Return the bits that each sensor gives at each step, `[T, n_s + 2]`.

    The last two are of all sensors but the first, and of all.
    """
    return np.asarray(_information(records, params, padded(records, seen), jump))[: len(seen)]


@partial(jax.jit, static_argnames="jump")
def _information(records, params, z, jump):
    filter, n = build_filter(jump), records.n_sensors
    together = jnp.ones((2, n), bool).at[0, 0].set(False)
    shown = jnp.concatenate([jnp.eye(n, dtype=bool), together])

    def step(belief, z):
        belief = filter.predict(records, params, belief)
        before = filter.posterior(records, belief)

        def told(shown):
            after, _ = filter.update(records, params, belief, jnp.where(shown, z, jnp.nan))
            after = filter.posterior(records, after)
            ratio = jnp.where((after > 0) & (before > 0), after / before, 1)
            return jnp.sum(after * jnp.log2(ratio))

        return filter.update(records, params, belief, z)[0], jax.lax.map(told, shown)

    return jax.lax.scan(step, filter.init(records), z)[1]


def in_parts(values: np.ndarray) -> np.ndarray:
    """Return the means `[n, PARTS]` of values `[T, n]` over parts of equal duration."""
    return np.array([part.mean(axis=0) for part in np.array_split(values, PARTS)]).T


def table(bits: np.ndarray) -> str:
    """Return the bits of each sensor, over the run and its quarters, with intervals over sets."""
    quarters = bits.reshape(*bits.shape[:2], 4, -1).mean(axis=-1)
    heads = ["whole run", "1st quarter", "2nd", "3rd", "4th"]
    lines = [f"{'bits/s of':14}" + "".join(f"{head:>20}" for head in heads)]
    for k, name in enumerate([*SENSOR_NAMES, *TOGETHER]):
        columns = [quarters[:, k].mean(axis=1), *quarters[:, k].T]
        lines.append(f"{name:14}" + "".join(f"{number(interval(x), 2):>20}" for x in columns))
    return "\n".join(lines)


def figure(bits: np.ndarray, path: Path) -> None:
    """Draw the bits of each sensor over the run; proximeters from the left to the right."""
    middle = (np.arange(PARTS) + 0.5) / PARTS
    with plt.rc_context({"font.size": 8, "axes.spines.top": False, "axes.spines.right": False}):
        drawn, (left, right) = plt.subplots(
            1, 2, figsize=(7.5, 2.8), layout="constrained", width_ratios=[1, 1.1]
        )
        for k, style, name in ((0, "-", "camera"), (-2, "--", "the six proximeters together")):
            mean, low, high = np.array([interval(x) for x in bits[:, k].T]).T
            left.fill_between(middle, np.maximum(low, 0), high, color="0.8", lw=0)
            left.plot(middle, mean, style, color="black", label=name)
        left.set(xlabel="share of the run", ylabel="information, bit/s", xlim=(0, 1))
        left.set_ylim(bottom=0)
        left.legend(frameon=False, loc="lower left", bbox_to_anchor=(0, 1), ncols=2)
        image = right.imshow(
            bits[:, 1:-2].mean(axis=0), aspect="auto", cmap="gray_r", extent=(0, 1, 5.5, -0.5)
        )
        right.set(xlabel="share of the run", ylabel="proximeter, from the left")
        drawn.colorbar(image, label="information, bit/s")
        drawn.savefig(path, dpi=150)
        plt.close(drawn)


if __name__ == "__main__":
    main()
