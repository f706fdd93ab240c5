"""Pictures of a posterior: prior against posterior in pairs of parameters, predicted deposits, how runs narrowed it."""

from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from inverse.observations.profile import Profile
from inverse.posterior.settings import CONSTANTS
from inverse.report.pictures import COLOURS, WIDTH, save
from validation.loop.result import Result

PAIRS = 5
"""Parameters up to which every pair is drawn; of more, each by itself."""
BINS = 40


def draw_posterior(path: Path, result: Result) -> None:
    """Prior and posterior of every parameter, and the samples of every pair; answers as crosses, the truth dashed."""
    parameters, samples = result.problem.parameters, result.samples
    weights = result.outcome.state.posterior.samples.weights
    count = len(parameters)
    if count > PAIRS:
        figure, grid = plt.subplots(-(-count // 4), 4, figsize=(WIDTH, 2.0 * -(-count // 4)), layout="constrained")
        axes = grid.ravel()
        for axis in axes[count:]:
            axis.axis("off")
        for index in range(count):
            _marginal(axes[index], result, samples, weights, index)
        return save(figure, path)
    side = min(WIDTH, 3.2 * count + 1.0)
    figure, grid = plt.subplots(count, count, figsize=(side, 0.85 * side), layout="constrained", squeeze=False)
    truth = result.target.truth or {}
    for row in range(count):
        for column in range(count):
            axis = grid[row, column]
            if column > row:
                axis.axis("off")
            elif column == row:
                _marginal(axis, result, samples, weights, row)
            else:
                across, up = parameters[column], parameters[row]
                axis.scatter(samples[:, column], samples[:, row], s=2.0, alpha=0.3, color=COLOURS["MPM"], linewidths=0)
                for answer in result.outcome.answers:
                    axis.plot(answer.parameters[column], answer.parameters[row], "x", color="tab:red")
                if across.name in truth:
                    axis.plot(truth[across.name], truth[up.name], "+", color="black", markersize=10)
                axis.set(xlim=(across.lower, across.upper), ylim=(up.lower, up.upper))
                axis.set_xlabel(f"{across.name} [{across.kind.unit}]", fontsize=8)
                axis.set_ylabel(f"{up.name} [{up.kind.unit}]", fontsize=8)
                axis.tick_params(labelsize=8)
    return save(figure, path)


def _marginal(axis: Axes, result: Result, samples: np.ndarray, weights: np.ndarray, index: int) -> None:
    each, truth = result.problem.parameters[index], result.target.truth or {}
    axis.hist(
        samples[:, index],
        bins=BINS,
        range=(each.lower, each.upper),
        weights=weights,
        density=True,
        color=COLOURS["MPM"],
    )
    axis.axhline(1.0 / each.range, color="#888888", linestyle=":", linewidth=1.0)
    for answer in result.outcome.answers:
        axis.axvline(answer.parameters[index], color="tab:red", linewidth=0.8)
    if each.name in truth:
        axis.axvline(truth[each.name], color="black", linestyle="--", linewidth=1.0)
    axis.set_xlim(each.lower, each.upper)
    axis.set_yticks([])
    axis.set_xlabel(f"{each.name} [{each.kind.unit}]", fontsize=8)
    axis.tick_params(labelsize=8)


def draw_predictive(path: Path, result: Result) -> None:
    """Profiles of the runs in the 95 % region over the target's, and their difference along x."""
    scene, state, target = result.problem.scene, result.outcome.state, result.target
    profile = Profile(scene, 2.0 * scene.domain.cell)
    log_likelihood = state.posterior.likelihood(state.points)
    threshold = float(np.quantile(state.posterior.samples.log_likelihood, 1.0 - CONSTANTS.credible))
    inside = [run for run, each in zip(state.runs, log_likelihood, strict=True) if each >= threshold]
    inside = inside or list(result.outcome.answers[0].checks)
    heights = np.stack([profile.heights(run.trajectory.positions[-1]) for run in inside])
    figure, (above, below) = plt.subplots(2, 1, figsize=(WIDTH, 5.0), sharex=True, layout="constrained")
    above.plot(profile.stations, heights.T, color=COLOURS["MPM"], linewidth=0.6, alpha=0.5)
    above.plot([], [], color=COLOURS["MPM"], label=f"MPM, {len(inside)} runs in the 95 % region")
    known = None
    if target.deposit is not None:
        known = profile.heights(target.deposit)
    elif target.profile is not None:
        known = np.interp(profile.stations, *target.profile, left=0.0, right=0.0)
    if known is not None:
        above.plot(profile.stations, known, color=COLOURS["target"], label="target")
        below.plot(profile.stations, (heights - known).T, color=COLOURS["MPM"], linewidth=0.6, alpha=0.5)
        below.axhline(0.0, color=COLOURS["target"], linewidth=0.8)
    elif np.isfinite(target.front):
        above.axvline(target.front, color=COLOURS["target"], label="target's front")
    if known is None:
        below.plot(profile.stations, (heights - heights.mean(axis=0)).T, color=COLOURS["MPM"], linewidth=0.6, alpha=0.5)
    above.set_ylabel("height [m]", fontsize=8)
    below.set_ylabel("less the target [m]" if known is not None else "less their mean [m]", fontsize=8)
    below.set_xlabel("x [m]", fontsize=8)
    above.legend(fontsize=8, frameon=False)
    for axis in (above, below):
        axis.tick_params(labelsize=8)
    save(figure, path)


def draw_waves(path: Path, result: Result) -> None:
    """Mean and standard deviation of every parameter over the runs of the MPM, in fractions of its range."""
    waves = result.outcome.state.waves
    runs = [each.runs for each in waves]
    figure, (above, below) = plt.subplots(2, 1, figsize=(WIDTH, 5.0), sharex=True, layout="constrained")
    for index, each in enumerate(result.problem.parameters):
        mean = np.array([wave.mean[index] for wave in waves])
        spread = np.array([wave.deviation[index] for wave in waves])
        (line,) = above.plot(runs, mean, ".-", linewidth=1.0, label=each.name)
        above.fill_between(runs, mean - 1.96 * spread, mean + 1.96 * spread, color=line.get_color(), alpha=0.12)
        below.semilogy(runs, np.maximum(spread, 1e-6), ".-", color=line.get_color(), linewidth=1.0)
        if result.target.truth:
            share = (result.target.truth[each.name] - each.lower) / each.range
            above.axhline(share, color=line.get_color(), linestyle="--", linewidth=0.8)
    above.set(ylim=(-0.02, 1.02))
    above.set_ylabel("mean ± 1.96 standard deviations\n[fraction of the range]", fontsize=8)
    below.set_ylabel("standard deviation\n[fraction of the range]", fontsize=8)
    below.set_xlabel("runs of the MPM", fontsize=8)
    for axis in (above, below):
        axis.tick_params(labelsize=8)
    above.legend(fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    save(figure, path)
