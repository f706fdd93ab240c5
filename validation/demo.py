"""`python -m validation.demo`: a tall column with a secret friction angle, found again from its front alone."""

import secrets
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from cyclopts.types import NonNegativeInt

from datasets.command_line import run

ANGLES_DEG = (18.0, 42.0)  # range from which the friction angle is drawn


def main(*, out: Path = Path("out/demo"), seed: NonNegativeInt | None = None, model: Path | None = None) -> None:
    """Draw a friction angle, let the MPM make a front with it, and find the angle again from that front.

    Writes OUT/result.json, OUT/report.md, pictures and OUT/mpm.

    Args:
        out: Folder for the results.
        seed: Makes the angle repeatable; by default, the operating system's randomness draws it.
        model: Weights of the surrogate; by default, the shipped ones.
    """
    # Imported here: torch takes seconds to load, and --help does not need it.
    from datasets.flow import measures
    from inverse.observations import FrontSettings
    from inverse.problem import read_problem
    from inverse.saving import save
    from inverse.settings import Surrogate, TargetSettings
    from mpm import LAST, simulate
    from validation.loop.solve import print_outcome, solve

    seed = secrets.randbits(32) if seed is None else seed
    stream = np.random.default_rng(seed)
    truth_deg, jitter = float(stream.uniform(*ANGLES_DEG)), int(stream.integers(1, 2**31))
    stated = read_problem("friction-tall-42")
    scene = replace(stated.scene.with_friction_deg(truth_deg), seed=jitter)
    flow = simulate(scene, record=LAST)
    front = measures.front(flow.positions[-1], flow.volumes)
    print(f"A column {scene.masses[0].size[0]} m long and {scene.masses[0].size[1]} m high ran to x = {front:.4f} m.")
    print("Which friction angle did it have? The front is all that the inversion is given.\n")

    # From here on, neither the angle nor its deposit is used until the answer is found.
    (parameter,) = stated.numbers
    problem = replace(
        stated,
        name="demo",
        scene=stated.scene.with_friction_deg(parameter.start),
        observations=(FrontSettings(value=front),),
        target=TargetSettings(),
        surrogate=Surrogate.GNS,
    )
    result = solve(problem, out, model=model)

    target = replace(result.target, deposit=flow.positions[-1], truth={parameter.name: truth_deg})
    drawn = "" if "--seed" in result.command or not result.command else f" --seed {seed}"
    result = replace(result, target=target, command=result.command + drawn)
    save(result, out)
    print_outcome(result, out)


if __name__ == "__main__":
    sys.exit(run(main, "python -m validation.demo"))
