"""`python -m validation.demo`: the tall column at a hidden angle of friction, found again from its front alone."""

import dataclasses
import secrets
import sys
from pathlib import Path

import numpy as np

from datasets import measures
from datasets.command_line import run
from gns.inference import SHIPPED
from gns.model import checkpoint
from inverse.forward.gns import GnsSource
from inverse.observations import deposit as observations
from inverse.observations.target import Target, read_target
from inverse.problem import TargetSettings, read_problem
from mpm import simulate, simulate_many
from mpm.output.request import LAST
from validation.loop.__main__ import finish, solve

ANGLES_DEG = (18.0, 42.0)
"""The hidden angle lies somewhere in here."""


def main(*, out: Path = Path("out/demo"), seed: int | None = None, model: Path = SHIPPED) -> None:
    """Hide an angle of friction, let the MPM make a front with it, and find it again from that front.

    Leaves OUT/result.json, OUT/report.md, pictures and OUT/mpm.

    Parameters
    ----------
    out
        Folder for the results.
    seed
        Makes the hidden angle repeatable; without it, the operating system's randomness draws it.
    model
        Weights of the surrogate.
    """
    stream = np.random.default_rng(secrets.randbits(64) if seed is None else seed)
    hidden_deg, jitter = float(stream.uniform(*ANGLES_DEG)), int(stream.integers(1, 2**31))
    stated = read_problem("friction-tall-42")
    scene = dataclasses.replace(stated.scene.with_friction_deg(hidden_deg), seed=jitter)
    deposit = simulate(scene, record=LAST).positions[-1]
    front = measures.front(deposit)
    print(f"A column {scene.masses[0].size[0]} m long and {scene.masses[0].size[1]} m high ran to x = {front:.4f} m.")
    print("Which angle of friction did it have? The front is all that the inversion is given.\n")

    # From here on nothing but the front is known: neither the hidden angle nor its deposit enters `solve`.
    blank = stated.scene.with_friction_deg(stated.unknowns[0].initial)
    problem = dataclasses.replace(stated, name="demo", scene=blank, target=TargetSettings(value=front))
    observation = observations.build(problem.observation, problem.scene)
    source = GnsSource(checkpoint.load(model).simulator, problem, observation)
    target = read_target(problem, observation, simulate)
    solved = solve(problem, target, observation, out, source, simulate_many)

    # The answer stands; now the truth may be told.
    revealed = Target(
        values=target.values, edge=target.edge, deposit=deposit, truth={problem.unknowns[0].name: hidden_deg}
    )
    result = dataclasses.replace(solved.result, target=revealed)
    finish(dataclasses.replace(solved, result=result), out)


if __name__ == "__main__":
    sys.exit(run(main, "python -m validation.demo"))
