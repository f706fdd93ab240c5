"""`python -m validation.bench speed`: rates of the MPM, cost of features, shortcuts, a training set."""

import tempfile
from pathlib import Path

from datasets.definitions.obstacle3d import OBSTACLE3D
from datasets.errors import InputError
from datasets.processes import processors
from mpm.generate import generate
from validation.bench.speed import features, rates
from validation.bench.speed.features import FULL, PLAIN, REST, SHORT, Features, Shortcuts
from validation.bench.speed.rates import Rates
from validation.bench.speed.timing import in_turn, ratio, seconds_of
from validation.report.page import Page

MORE_ROUNDS = 2
"""Rounds of the features, whose differences are small, in one of the others."""
RATES = """
    2D: the paper's tall column (42°, damped, cohesive), 4 particles per cell. 3D: a cube of its 3D sand, 8 per cell.
    Small scenes are timed until the flow is well under way, large ones over its first frames, one sort by cell included
    (in use it comes every 20 frames). One scene of fewer than 20,000 particles runs on one thread, copies on a thread
    each. The aims, and half of what vector code written by hand does on as many threads, are for f32 on two cores of an
    AMD EPYC.
"""
FEATURES = """
    Seconds of a column with one feature, over those of the same column with friction alone. The feature is switched on
    with a value too small to change the flow. The whole grid is made active by one cell of material in the far upper
    corner.
"""
SHORTCUTS = """
    Seconds over those of the scene as it ships (its full time, step 0.9 of the stability limit), and the change of the
    front. Ending at rest is on request (`until_rest`): below a thousandth of the greatest kinetic energy.
"""
METHODS = """
    - **Vectors of lanes** (`mpm/arrays/access.py`). Particles are stored in blocks as wide as a vector register, 16 in
      f32 and 8 in f64. Stress, return mapping, weights and motion of a block are computed at once, without branches;
      with `real_matrix_scalarize=False` Taichi leaves its vectors whole, so LLVM uses the registers.
    - **Nodes as short vectors** (`mpm/physics/transfer.py`). In the transfer a node (momentum, mass, force) is one
      vector of four or eight numbers. What a particle adds is linear in the node's position: a value at the lowest node
      and one slope per axis. What it gathers is summed along the innermost axis first, since those nodes share the
      other weights.
    - **Bounded indices** (`mpm/arrays/access.py`). Taichi counts in 32 bits, and each sum of an index and a constant
      would be extended anew; cut to 30 bits, which changes none, it becomes part of an address.
    - **No atomics, few launches** (`mpm/kernel.py`). A small scene runs on one thread, many small ones side by side; a
      large one has a grid per thread, summed where they overlap. Up to 20 frames with all their steps are one launch.
    - **Particles in the order of their cells** from 50,000 on, sorted anew at every launch.
    - **Features on demand**: the kernel is compiled for the features of a batch of scenes, and only the bounding box of
      the material is cleared and updated.
"""


def bench(out: Path, *, quick: bool, keep: Path, rounds: int = 3, trajectories: int = 20) -> str:
    """Measure rates over sizes, dimensions, threads and precisions, and the cost of features; about three minutes.

    Parameters
    ----------
    out
        Folder for speed.md.
    quick
        Four small cases of a single frame, one round, one shortcut, one trajectory.
    keep
        Not used: times are of one run.
    rounds
        How often everything is measured, in turn; the tables give the median and the range.
    trajectories
        How many of Obstacle3D are generated to estimate the whole; none with 0.
    """
    if rounds < 1:
        raise InputError(f"expected at least 1, got {rounds}", key="--rounds")
    if not 0 <= trajectories <= OBSTACLE3D.size:
        raise InputError(f"expected 0 to {OBSTACLE3D.size}, got {trajectories}", key="--trajectories")
    if quick:
        rounds, trajectories = 1, 1
    speeds = in_turn(rates.runs(rates.QUICK if quick else rates.CASES), rounds, "rates")
    switched = in_turn(features.feature_runs((2,) if quick else (2, 3)), MORE_ROUNDS * rounds, "features")
    short = in_turn(features.shortcut_runs(features.SCENES[: 1 if quick else None]), rounds, "shortcuts")
    training = generation(trajectories) if trajectories else ""
    command = f"python -m validation.bench speed --rounds {rounds} --trajectories {trajectories}"
    return page(speeds, switched, short, command=command, training=training, quick=quick).write(out / "speed.md")


def generation(count: int) -> str:
    """Generate some of Obstacle3D; returns what all of it would take."""
    jobs = processors()
    with tempfile.TemporaryDirectory() as folder:
        seconds = seconds_of(lambda: generate(OBSTACLE3D, Path(folder), seed=0, count=count, jobs=jobs))
        size = sum(path.stat().st_size for path in Path(folder).rglob("*.npz"))
    one, one_size, whole = seconds / count, size / count, OBSTACLE3D.size
    return (
        f"`python -m mpm.generate obstacle3d --count {count} --jobs {jobs}`, with the start of the processes and the"
        f" statistics: {seconds:.0f} s and {size / 1.0e9:.2f} GB, {one:.2f} s and {one_size / 1.0e6:.0f} MB a"
        f" trajectory. All {whole:,} would take {one * whole / 60.0:.0f} minutes and {one_size * whole / 1.0e9:.0f} GB."
    )


def page(
    speeds: Rates, switched: Features, short: Shortcuts, *, command: str, training: str = "", quick: bool = False
) -> Page:
    """The page; `training` is a section of its own."""
    text = Page("The speed of the MPM", command=command, conclusion=conclusion(speeds, switched, short), quick=quick)
    text.text("""
        Medians of rounds in which all are measured in turn, in brackets minimum and maximum. Compilation is not
        included: 0.5 to 3 s the first time, cached on disk from then on.
    """)
    text.section("Million particle-steps a second")
    text.text(RATES)
    text.table(rates.rate_rows(speeds))
    text.text("Other codes, on two cores of an AMD EPYC, not in this run (`validation/bench/speed/speed.toml`):")
    text.table(rates.other_rows())
    text.section("The cost of features")
    text.text(FEATURES)
    text.table(features.feature_rows(switched))
    text.section("Shortcuts")
    text.text(SHORTCUTS)
    text.table(features.shortcut_rows(short))
    if training:
        text.section("A training set in 3D")
        text.text(training)
    text.section("Methods")
    text.text(METHODS)
    return text


def conclusion(speeds: Rates, switched: Features, short: Shortcuts) -> list[str]:
    """Rates against aims, cost of features and of the grid, gain of shortcuts."""
    found = []
    cases = list(dict.fromkeys(case for case, _ in speeds))
    for dimension in sorted({case.dimension for case in cases}):
        some = [case for case in cases if case.dimension == dimension]
        values = [rates.best(speeds, case).median for case in some]
        attained = sum(case.aim is not None and value >= case.aim for case, value in zip(some, values, strict=True))
        found.append(
            f"In {dimension}D {min(values):.1f} to {max(values):.1f} million particle-steps a second from"
            f" {some[0].particles:,} to {some[-1].particles:,} particles; {attained} of"
            f" {sum(case.aim is not None for case in some)} aims are met."
        )
    ratios = {
        name: max(ratio(switched[d, one], switched[d, other]).median for d in {d for d, _ in switched})
        for name, (one, other) in features.comparisons(min(d for d, _ in switched)).items()
    }
    single = [name for name, (_, other) in features.comparisons(2).items() if other == PLAIN]
    dearest = max(single, key=lambda name: ratios[name])
    grid = max(value for name, value in ratios.items() if name.startswith("whole grid"))
    found.append(
        f"The costliest single feature is {dearest}, x {ratios[dearest]:.2f}; updating the whole grid instead of the"
        f" active box would cost up to x {grid:.2f}."
    )
    names = list(dict.fromkeys(name for name, _ in short))
    gains = [ratio(short[name, REST], short[name, FULL]).median for name in names]
    costs = [ratio(short[name, SHORT], short[name, FULL]).median for name in names]
    shifts = [1000.0 * abs(short[name, SHORT][0].front - short[name, FULL][0].front) for name in names]
    found.append(
        f"Ending at rest takes {min(gains):.2f} to {max(gains):.2f} of the seconds; a step of 0.4 instead of 0.9 of the"
        f" limit takes {min(costs):.2f} to {max(costs):.2f} times as long and moves fronts by up to"
        f" {max(shifts):.1f} mm."
    )
    return found
