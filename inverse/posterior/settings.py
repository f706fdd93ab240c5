"""The constants of the method in one place, each with its reason."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Constants:
    """Of the emulator, the samples, the answers and the runs."""

    # Emulator
    max_components: int = 24
    """Components of an observation that are emulated; with more the last ones are scatter."""
    beyond_linear: int = 4
    """How many of them besides one for each parameter: the observation curves as they change."""
    length_scale: float = 0.7
    """Prior median of a correlation length over the box's diagonal: a flow changes steadily over the box."""
    length_spread: float = 0.8
    """Standard deviation of its logarithm: from a seventh of the diagonal to more than three times it."""
    scatter_spread: float = 0.7
    """Standard deviation of the logarithm of a component's scatter around that of repeated runs: a factor of two."""
    scatter_prior: float = 2.0
    """Degrees of freedom that all components together add to the scatter of each."""
    smallest_scatter: float = 0.02
    """Of the scatter that is expected, where runs show none: no flow is known better than to rounding and step."""
    ratio_prior: float = 4.0
    """Runs predicted as stated that count besides those around: the squares of few errors are uncertain."""
    smallest_ratio: float = 0.9
    """Factor of a variance at least, however well the runs around are predicted."""
    separate_lengths: int = 8
    """Parameters up to which each has a correlation length of its own; beyond, runs are too few to tell them apart."""
    other_regime: float = 0.25
    """Squared error of runs left out, over that by an emulator of all, below which one is of a regime alone."""
    regime_gap: float = 3.0
    """Distance of a run from the target over that of the next nearer one, from which on it may be of another regime."""

    # Samples
    populations: int = 2
    """Independent ones, whose difference is the diagnostic."""
    samples: int = 1500
    """Of a population: the 95 % limits are known to about a tenth of a standard deviation."""
    effective: float = 0.5
    """Share of the samples that stays effective from one stage of tempering to the next."""
    jumps: int = 3
    """Accepted moves of a sample at each stage, on average: enough that copies part."""
    max_sweeps: int = 40
    """Sweeps of a stage at most, where hardly any move is accepted."""

    # Answers
    credible: float = 0.95
    """Of every interval and region."""
    neighbours: int = 15
    """Samples that each is joined with, where the segment between them stays in the region."""
    smallest_weight: float = 0.02
    """Weight of a separate part of the region below which it is no answer."""
    most_of_the_prior: float = 0.5
    """Length of an interval over the range between the bounds, above which a parameter is not identifiable."""

    # Runs of the MPM
    first_runs: int = 6
    """Runs that fill the box evenly, besides `first_per_unknown`."""
    first_per_unknown: int = 2
    """Of each parameter: as many as a straight line has coefficients."""
    wave: int = 2
    """Runs of a wave besides one for each parameter and `repeats`: as many as two cores make in a second."""
    repeats: int = 3
    """Runs of a wave at the same parameters, the mean of the posterior so far: their scatter is the flow's alone."""
    narrow_above: float = 0.5
    """Share of the emulator in the variance of the residuals, above which the region narrows."""
    converged: float = 0.15
    """Share of the emulator in the variance of the residuals, below which further runs shorten intervals little."""
    converged_around: float = 0.7
    """The same around a surrogate's answers, and where runs for other targets are known: for half as many runs."""
    first_checks: int = 2
    """Runs at each answer of a surrogate: as many as two processors make in the time of one."""
    local_runs: int = 16
    """Runs around an answer, of which an emulator of them alone is made: the scatter is known to a fifth."""
    around_deviations: float = 2.0
    """Standard deviations from the mean of the samples within which runs make the last emulator."""
    lack_of_fit: float = 0.9
    """Quantile of the ratio of variances up to which the scatter about the emulator is that of repeated runs."""
    margin: float = 0.25
    """Of the extent of the samples, on either side, up to which the next ones lie and runs count."""
    at_edge: float = 0.02
    """Share of samples in the outermost tenth of that extent on a side, above which it was too narrow."""
    at_edge_of_many: float = 0.3
    """The same of more than `few_parameters`, whose region is narrow on purpose: three times that of even samples."""
    few_parameters: int = 6
    """Parameters up to which runs go where the emulator's variance is largest; of more they fill the region evenly."""
    region_deviations: float = 2.5
    """Standard deviations within which the next runs of more than `few_parameters` lie: ten of them hold 88 %."""
    beyond_region: float = 1.2
    """Extent of their samples over that of the runs: of a normal posterior of ten parameters 97 % lie within."""
    runs_per_coefficient: float = 2.0
    """Different runs in a region, for each coefficient of the trend, from which on they alone make its emulator."""
    checks: int = 4
    """Runs at an answer, whose mean is compared with the target: halves the scatter."""
    few_checks: int = 2
    """The same where a surrogate leads, a run being dear, or runs for other targets are known and show the scatter."""
    moves: int = 2
    """Times that an answer is checked where it has moved to."""
    rounds: int = 4
    """Times that answers are checked in all."""


CONSTANTS = Constants()
