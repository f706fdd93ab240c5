"""The constants of the method in one place, each with its reason."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Constants:
    """Constants of the emulator, the samples, the answers and the runs."""

    # Emulator
    max_components: int = 24  # largest number of emulated components of an observation; further ones would be scatter
    beyond_linear: int = 4  # components in addition to one for each parameter, for the curvature of the observation
    length_scale: float = 0.7  # prior median of a correlation length over the box's diagonal: flows change steadily
    length_spread: float = 0.8  # standard deviation of its logarithm: a seventh of the diagonal to over three times it
    scatter_spread: float = 0.7
    """Standard deviation of the logarithm of a component's scatter around that of repeated runs: a factor of two."""
    scatter_prior: float = 2.0  # degrees of freedom that all components together add to the scatter of each
    smallest_scatter: float = 0.02  # smallest scatter over the expected one: rounding and time step limit the accuracy
    ratio_prior: float = 4.0
    """Number of runs with errors as stated that are added to those around: the squares of few errors are uncertain."""
    smallest_ratio: float = 0.9  # smallest factor of a variance, however well the runs around are predicted
    separate_lengths: int = 8  # most parameters with separate correlation lengths; for more, there are too few runs
    other_regime: float = 0.25
    """Squared leave-one-out error over that of an emulator of all runs, below which an emulator has only one regime."""
    regime_gap: float = 3.0
    """Distance of a run from the target over that of the next nearer run, above which it may be in another regime."""

    # Samples
    populations: int = 2  # number of independent populations, whose difference is the diagnostic
    samples: int = 1500  # samples in a population: the 95 % limits are known to about a tenth of a standard deviation
    effective: float = 0.5  # share of the samples that stays effective from one stage of tempering to the next
    jumps: int = 3  # mean number of accepted moves of a sample at each stage: enough to separate copies
    max_sweeps: int = 40  # largest number of sweeps in a stage, if hardly any move is accepted

    # Answers
    credible: float = 0.95  # probability of every interval and region
    neighbours: int = 15  # number of samples to which each is joined, if the segment between them stays in the region
    smallest_weight: float = 0.02  # smallest weight of a separate part of the region that is an answer
    most_of_the_prior: float = 0.5  # length of an interval over the range, above which a parameter is not identifiable

    # Runs of the MPM
    first_runs: int = 6  # runs that fill the box evenly, in addition to `first_per_unknown`
    first_per_unknown: int = 2  # first runs for each parameter: as many as a straight line has coefficients
    wave: int = 2  # runs of a wave besides one per parameter and `repeats`: as many as two cores make in a second
    repeats: int = 3  # runs of a wave at the same parameters, the posterior mean so far: the scatter of flows
    narrow_above: float = 0.5  # share of the emulator in the variance of the residuals, above which the region narrows
    converged: float = 0.15  # the emulator's share of the variance below which further runs hardly narrow the intervals
    converged_around: float = 0.7
    """The same around a surrogate's answers, or with known runs for other targets: it needs half as many runs."""
    first_checks: int = 2  # runs at each answer of a surrogate: as many as two processors make in the time of one
    local_runs: int = 16  # runs around an answer that suffice for their own emulator: scatter known to a fifth
    around_deviations: float = 2.0  # the last emulator uses runs within so many deviations of the samples' mean
    lack_of_fit: float = 0.9
    """Quantile of the ratio of variances up to which the scatter about the emulator is that of repeated runs."""
    margin: float = 0.25  # margin of the next region on either side, as a share of the extent of the samples
    at_edge: float = 0.02  # share of samples in the outermost tenth of a side, above which the region was too narrow
    at_edge_of_many: float = 0.3
    """The same beyond `few_parameters`, where the region is narrow on purpose: three times that of even samples."""
    few_parameters: int = 6  # up to so many, runs go where the emulator varies most; with more, evenly over the region
    region_deviations: float = 2.5
    """Standard deviations within which the next runs lie beyond `few_parameters`: with ten parameters, this is 88 %."""
    beyond_region: float = 1.2  # extent of the samples over that of the runs beyond `few_parameters`: with ten, 97 %
    runs_per_coefficient: float = 2.0
    """Different runs in a region, per coefficient of the trend, that suffice for an emulator of these runs only."""
    checks: int = 4  # runs at an answer, whose mean is compared with the target: this halves the scatter
    few_checks: int = 2  # the same if a surrogate leads (runs are dear), or if runs for other targets show the scatter
    moves: int = 2  # number of times that an answer is checked again after it has moved
    rounds: int = 4  # largest number of checking rounds in total


CONSTANTS = Constants()
