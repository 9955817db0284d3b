"""The figure of parameters after each optimisation step, and of scores at the checkpoints."""

from typing import Any

import matplotlib
import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter

from jaxreplay.figures.picture import Picture, literal
from jaxreplay.recordings.scores import sensor_span
from jaxreplay.recordings.tune import Tuned
from jaxreplay.records import Records

_STYLES = ("-", "--", "-.", ":")


def tuning_figure(records: Records, tuned: Tuned) -> Picture:
    """Return a figure of the scores at the checkpoints and of the parameters after every step.

    Args:
        records: the records that the parameters were tuned on.
        tuned: the result of tuning.
    """
    steps = np.arange(len(tuned.path.theta_i))
    plain: Any = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}
    with matplotlib.rc_context(plain):
        figure = Picture(figsize=(9, 5.5), dpi=120)
        axes = figure.subplots(2, 2, sharex=True)
        (evidence, thetas), (error, sigmas) = axes
        evidence.plot(tuned.checkpoints, tuned.scores.log_evidence, "o-", ms=3, color="black")
        evidence.set_ylabel("log evidence per time step")
        error.plot(tuned.checkpoints, 100 * tuned.scores.command_error, "o-", ms=3, color="black")
        error.set_ylabel("command error, % of range")
        thetas.semilogy(steps, tuned.path.theta_i, "-", color="black", label="$\\theta_I$")
        thetas.semilogy(steps, tuned.path.theta_tau, "--", color="0.4", label="$\\theta_\\tau$")
        thetas.set_ylabel("probability")
        shares = np.asarray(tuned.path.sigma) / sensor_span(records)
        colours = matplotlib.colormaps["viridis"](np.linspace(0, 0.85, len(records.sensor_names)))
        for k, name in enumerate(records.sensor_names):
            style = _STYLES[k % len(_STYLES)]
            sigmas.semilogy(
                steps, shares[:, k], style, color=colours[k], label=f"$\\sigma$ {literal(name)}"
            )
        sigmas.set_ylabel("σ, share of the sensor's range")
        for ax in axes.flat:
            ax.axvline(tuned.checkpoints[tuned.best], color="0.7", lw=0.8, zorder=0)
        for ax in (thetas, sigmas):
            ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            ax.yaxis.set_major_formatter("{x:g}")
            ax.yaxis.set_minor_formatter(NullFormatter())
            ax.legend(loc="center left", bbox_to_anchor=(1, 0.5), frameon=False, fontsize=8)
        for ax in axes[1]:
            ax.set_xlabel("optimisation step")
        n = len(tuned.scores.steps)
        figure.suptitle(
            f"{n} records, each left out in turn; {tuned.jump}, selected by {tuned.score}; "
            "grey line: the parameters kept",
            fontsize=9,
        )
    return figure
