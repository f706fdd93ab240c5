"""Seconds of one step of the shipped networks over their nodes, with and without its gradient, for the page `speed`."""

import dataclasses

import torch

import gns
from datasets.material import Material
from datasets.scene import Domain, Mass, Scene
from gns.initial import initial_state
from gns.library import models
from validation.report.measuring import seconds_of, spread

LENGTHS = {2: (0.2, 1.5, 15.0), 3: (0.3, 1.2, 4.8)}
"""Of the body [m], by dimension: a step costs per node, and a longer body has as many neighbours for each."""
ACROSS = {2: 0.4, 3: 0.3}
"""Its height, in 3D its width too [m]."""


def body(dimension: int, length: float) -> Scene:
    """A body of sand at rest at the left wall of a box."""
    across, cell = ACROSS[dimension], 0.01 if dimension == 2 else 0.03
    return Scene(
        domain=Domain(size=(length + 0.6, 1.5 * across, across)[:dimension], cell=cell),
        material=Material(friction_deg=30.0),
        masses=(Mass(lower=(0.0,) * dimension, size=(length, across, across)[:dimension]),),
        duration=1.0,
        floor_friction=0.4,
    )


def network_rows(*, rounds: int = 3, sizes: int = 3) -> list[dict[str, str]]:
    """A row for each model that ships and each of so many sizes; one thread, medians of rounds."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    rows = []
    for path in models():
        simulator = gns.load(path)
        # A model scales every scene to the body of its training data; as it is, a longer one has more nodes.
        simulator.settings = dataclasses.replace(simulator.settings, body_length=None)
        for length in LENGTHS[simulator.settings.dimension][:sizes]:
            initial = initial_state(body(simulator.settings.dimension, length), simulator.settings)
            state, friction = initial.state, initial.conditions.friction.clone().requires_grad_()
            conditions = dataclasses.replace(initial.conditions, friction=friction)

            def forward() -> None:
                with torch.no_grad():
                    simulator(state, conditions)  # noqa: B023

            def gradient() -> None:
                simulator(state, conditions).positions.sum().backward()  # noqa: B023

            forward()
            gradient()
            own, both = (spread(seconds_of(work) for _ in range(rounds)) for work in (forward, gradient))
            rows.append(
                {
                    "model": f"`{path.stem}`",
                    "nodes": f"{len(initial.indices):,}",
                    "forward [s]": own.written(4),
                    "with gradient [s]": both.written(4),
                    "µs per node": f"{1.0e6 * both.median / len(initial.indices):.0f}",
                }
            )
    torch.set_num_threads(threads)
    return rows
