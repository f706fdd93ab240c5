"""The constants of the method in one place, each with its reason."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Constants:
    """Constants of the emulator, the samples, the answers and the runs."""

    # Emulator
    max_components: int = 24
    """Largest number of emulated components of an observation; further ones would be scatter."""
    beyond_linear: int = 4
    """Number of components in addition to one for each parameter, for the curvature of the observation."""
    length_scale: float = 0.7
    """Prior median of a correlation length over the box's diagonal: a flow changes steadily over the box."""
    length_spread: float = 0.8
    """Standard deviation of its logarithm: from a seventh of the diagonal to more than three times it."""
    scatter_spread: float = 0.7
    """Standard deviation of the logarithm of a component's scatter around that of repeated runs: a factor of two."""
    scatter_prior: float = 2.0
    """Degrees of freedom that all components together add to the scatter of each."""
    smallest_scatter: float = 0.02
    """Smallest scatter over the expected one, if runs show none: rounding and time step limit the accuracy."""
    ratio_prior: float = 4.0
    """Number of runs with errors as stated that are added to those around: the squares of few errors are uncertain."""
    smallest_ratio: float = 0.9
    """Smallest factor of a variance, however well the runs around are predicted."""
    separate_lengths: int = 8
    """Largest number of parameters with separate correlation lengths; for more, there are too few runs."""
    other_regime: float = 0.25
    """Squared leave-one-out error over that of an emulator of all runs, below which an emulator has only one regime."""
    regime_gap: float = 3.0
    """Distance of a run from the target over that of the next nearer run, above which it may be in another regime."""

    # Samples
    populations: int = 2
    """Number of independent populations, whose difference is the diagnostic."""
    samples: int = 1500
    """Samples in a population: the 95 % limits are known to about a tenth of a standard deviation."""
    effective: float = 0.5
    """Share of the samples that stays effective from one stage of tempering to the next."""
    jumps: int = 3
    """Mean number of accepted moves of a sample at each stage: enough to separate copies."""
    max_sweeps: int = 40
    """Largest number of sweeps in a stage, if hardly any move is accepted."""

    # Answers
    credible: float = 0.95
    """Probability of every interval and region."""
    neighbours: int = 15
    """Number of samples to which each is joined, if the segment between them stays in the region."""
    smallest_weight: float = 0.02
    """Smallest weight of a separate part of the region that is an answer."""
    most_of_the_prior: float = 0.5
    """Length of an interval over the range between the bounds, above which a parameter is not identifiable."""

    # Runs of the MPM
    first_runs: int = 6
    """Runs that fill the box evenly, in addition to `first_per_unknown`."""
    first_per_unknown: int = 2
    """First runs for each parameter: as many as a straight line has coefficients."""
    wave: int = 2
    """Runs of a wave in addition to one for each parameter and `repeats`: as many as two cores make in a second."""
    repeats: int = 3
    """Runs of a wave at the same parameters, the posterior mean so far, to measure the scatter of flows."""
    narrow_above: float = 0.5
    """Share of the emulator in the variance of the residuals, above which the region narrows."""
    converged: float = 0.15
    """Share of the emulator in the variance of the residuals, below which further runs hardly narrow the intervals."""
    converged_around: float = 0.7
    """The same around a surrogate's answers, or with known runs for other targets: it needs half as many runs."""
    first_checks: int = 2
    """Runs at each answer of a surrogate: as many as two processors make in the time of one."""
    local_runs: int = 16
    """Runs around an answer that suffice for their own emulator: the scatter is then known to a fifth."""
    around_deviations: float = 2.0
    """The last emulator uses the runs within so many standard deviations from the mean of the samples."""
    lack_of_fit: float = 0.9
    """Quantile of the ratio of variances up to which the scatter about the emulator is that of repeated runs."""
    margin: float = 0.25
    """Margin of the next region on either side, as a share of the extent of the samples."""
    at_edge: float = 0.02
    """Share of samples in the outermost tenth of the extent on a side, above which the region was too narrow."""
    at_edge_of_many: float = 0.3
    """The same beyond `few_parameters`, where the region is narrow on purpose: three times that of even samples."""
    few_parameters: int = 6
    """Up to so many parameters, runs are placed at the largest emulator variance; with more, evenly over the region."""
    region_deviations: float = 2.5
    """Standard deviations within which the next runs lie beyond `few_parameters`: with ten parameters, this is 88 %."""
    beyond_region: float = 1.2
    """Extent of the samples over that of the runs, beyond `few_parameters`: with ten, 97 % of a normal posterior."""
    runs_per_coefficient: float = 2.0
    """Different runs in a region, per coefficient of the trend, that suffice for an emulator of these runs only."""
    checks: int = 4
    """Runs at an answer, whose mean is compared with the target: this halves the scatter."""
    few_checks: int = 2
    """The same if a surrogate leads, because runs are expensive, or if runs for other targets show the scatter."""
    moves: int = 2
    """Number of times that an answer is checked again after it has moved."""
    rounds: int = 4
    """Largest number of checking rounds in total."""


CONSTANTS = Constants()
