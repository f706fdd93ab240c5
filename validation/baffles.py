"""python -m validation.baffles --out DIR: how well a baffle stands its ground, wherever it stands between the nodes."""

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets.command_line import run
from datasets.files import write_text
from datasets.material import Material
from datasets.scene import Baffle, Domain, Mass, Scene
from datasets.trajectory import Trajectory
from mpm.recording import LAST
from mpm.simulate import simulate_many

CELL = 0.02
SAND = Material(friction_deg=30.0)
PHASES = (0.0, 0.25, 0.5, 0.75, 0.9)
"""Where a face lies between two nodes [cells]."""
OFFSETS = np.arange(0.0, 2.01, 0.1)
"""How far the baffle of the flow is moved [cells]."""


def flow(offset: float, seed: int) -> Scene:
    """A column runs against a baffle that stands `offset` cells further on."""
    return Scene(
        domain=Domain(size=(1.6, 0.6), cell=CELL),
        material=SAND,
        masses=(Mass(lower=(0.0, 0.0), size=(0.3, 0.4)),),
        baffles=(Baffle(lower=(0.5 + offset * CELL, 0.0), size=(0.1, 0.12)),),
        floor_friction=0.4,
        baffle_friction=0.4,
        step_fraction=0.9,
        frame_dt=0.01,
        seed=seed,
    )


def retained(phase: float) -> Scene:
    """A bed 0.3 m deep, let go between a smooth wall and a smooth baffle, comes to rest."""
    length = 0.4 + phase * CELL
    return Scene(
        domain=Domain(size=(1.0, 0.6), cell=CELL),
        material=SAND,
        masses=(Mass(lower=(0.0, 0.0), size=(length, 0.3)),),
        baffles=(Baffle(lower=(length, 0.0), size=(0.2, 0.5)),),
        damping=0.2,
        step_fraction=0.9,
        frame_dt=0.01,
    )


def carried(phase: float) -> Scene:
    """A layer 0.2 m thick comes to rest on top of a baffle that fills the floor."""
    height = 0.1 + phase * CELL
    return Scene(
        domain=Domain(size=(0.4, 0.6), cell=CELL),
        material=SAND,
        masses=(Mass(lower=(0.0, height), size=(0.4, 0.2)),),
        baffles=(Baffle(lower=(0.0, 0.0), size=(0.4, height)),),
        damping=0.2,
        step_fraction=0.9,
        frame_dt=0.01,
    )


def force(trajectory: Trajectory) -> NDArray[np.float64]:
    """Mean force on the first baffle over the last 0.3 s [N per metre of width], shape [2]."""
    assert trajectory.baffle_impulse is not None
    impulse = trajectory.baffle_impulse[:, 0]
    mean: NDArray[np.float64] = (impulse[-1] - impulse[-31]) / 0.3
    return mean


def moved_table(seeds: int) -> list[str]:
    """The deposit and the impact over the place of the baffle."""
    flows = simulate_many([flow(offset, seed) for offset in OFFSETS for seed in range(seeds)], record=LAST)
    centre = np.array([t.positions[-1, :, 0].mean() for t in flows]).reshape(len(OFFSETS), seeds)
    push = np.array([0.0 if t.baffle_impulse is None else t.baffle_impulse[-1, 0, 0] for t in flows])
    push = push.reshape(len(OFFSETS), seeds)
    lines = ["| moved by [cells] | centre of the deposit [mm] | impulse on the baffle [N s/m] |", "|---|---|---|"]
    for offset, x, j in zip(OFFSETS, centre, push, strict=True):
        lines.append(f"| {offset:.1f} | {1000 * x.mean():.2f} | {j.mean():.0f} |")
    rows = []
    for name, series, unit in (("centre", 1000 * centre, "mm"), ("impulse", push, "N s/m")):
        mean = series.mean(axis=1)
        rough = np.abs(mean - np.polyval(np.polyfit(OFFSETS, mean, 2), OFFSETS))
        scatter = series.std(axis=1, ddof=1).mean() / np.sqrt(seeds)
        rows.append(
            f"The {name} lies {np.sqrt(np.mean(rough**2)):.2f} {unit} rms, {rough.max():.2f} {unit} at most, off a "
            f"smooth (quadratic) curve; the mean over {seeds} jitter seeds scatters by {scatter:.2f} {unit}."
        )
    return [*lines, "", *rows]


def standing_table() -> list[str]:
    """What a baffle bears and how far it gives way, over the place of its face between the nodes."""
    weight = 0.4 * 0.2 * SAND.density * 9.81
    lateral = 0.5 * SAND.poisson / (1 - SAND.poisson) * SAND.density * 9.81 * 0.3**2
    sides = simulate_many([retained(phase) for phase in PHASES])
    tops = simulate_many([carried(phase) for phase in PHASES])
    lines = [
        f"| face between nodes [cells] | side: force, of {lateral:.0f} N/m | side: moved [mm] "
        f"| top: force, of {weight:.0f} N/m | top: sunk [mm] |",
        "|---|---|---|---|---|",
    ]
    for phase, side, top in zip(PHASES, sides, tops, strict=True):
        moved = (side.positions[-1] - side.positions[0])[:, 0].mean()
        sunk = (top.positions[0] - top.positions[-1])[:, 1].mean()
        lines.append(
            f"| {phase:g} | {force(side)[0]:.0f} | {1000 * moved:.1f} | {-force(top)[1]:.0f} | {1000 * sunk:.1f} |"
        )
    return lines


def command(*, out: Path, seeds: int = 4) -> None:
    """Measure contact with a baffle: how smoothly a deposit follows it, what it bears, whether it gives way.

    Parameters
    ----------
    out
        Folder for baffles.md.
    seeds
        Jitters per place of the baffle.
    """
    text = "\n".join(
        [
            "# Contact with baffles",
            "",
            f"`python -m validation.baffles --seeds {seeds}`; cells of {1000 * CELL:g} mm; law in `mpm/baffles.py`.",
            "",
            "## A baffle is moved by a tenth of a cell at a time",
            "",
            "A column of 0.3 x 0.4 m runs against a baffle 0.12 m high; after 1 s:",
            "",
            *moved_table(seeds),
            "",
            "## A baffle bears what leans on it",
            "",
            "Side: a bed between a wall and a baffle, both smooth; the elastic K0 = nu / (1 - nu) gives the force.",
            "Top: a layer 0.2 m thick on a baffle as wide as the box, which bears its weight. Forces: the last 0.3 s.",
            "",
            *standing_table(),
            "",
        ]
    )
    write_text(out / "baffles.md", text)
    print(text)


if __name__ == "__main__":
    sys.exit(run(command, "python -m validation.baffles"))
