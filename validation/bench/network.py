"""Seconds of a step of the shipped networks, on the CPU or a GPU."""

from dataclasses import replace

from datasets.scene import Domain, Mass, Scene
from datasets.scene.material import Material
from validation.bench.measuring import Found, Spread, seconds_of

LENGTHS = {2: (0.2, 1.5, 15.0), 3: (0.3, 1.2, 4.8)}
"""Of the body of a network's step [m], by dimension: it costs per node, and a longer one has as many neighbours."""
ACROSS, CELLS = {2: 0.4, 3: 0.3}, {2: 0.01, 3: 0.03}
"""Its height, in 3D its width too [m], and its cells [m]."""
PER_NODE = "µs per node"
NETWORK = {"nodes": ",", "forward [s]": ".4f", "with gradient [s]": ".4f", PER_NODE: ".0f"}
"""Forms of the columns."""


def body(dimension: int, length: float) -> Scene:
    """A body of sand at rest at the left wall of a box."""
    across = ACROSS[dimension]
    return Scene(
        domain=Domain(size=(length + 0.6, 1.5 * across, across)[:dimension], cell=CELLS[dimension]),
        material=Material(friction_deg=30.0),
        masses=(Mass(lower=(0.0,) * dimension, size=(length, across, across)[:dimension]),),
        floor_friction=0.4,
    )


def network_rows(*, rounds: int, device: str = "cpu") -> list[Found]:
    """A row for each model that ships and each length: seconds of a step; one thread, medians of rounds."""
    # Here, because processes that only price a gradient do without PyTorch.
    import torch

    import gns
    from gns.library import models
    from gns.surroundings.initial import initial_state

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    rows: list[Found] = []
    for path in models():
        simulator = gns.load(path)
        # A model scales every scene to the body of its training data; as it is, a longer one has more nodes.
        simulator.settings = replace(simulator.settings, body_length=None)
        simulator.to(device)
        for length in LENGTHS[simulator.settings.dimension]:
            initial = initial_state(body(simulator.settings.dimension, length), simulator.settings)
            state, conditions = initial.state.to(device), initial.conditions.to(device)
            friction = conditions.friction.clone().requires_grad_()
            conditions = replace(conditions, friction=friction)

            def step(*, gradient: bool) -> None:
                with torch.set_grad_enabled(gradient):
                    moved = simulator(state, conditions).positions.sum()  # noqa: B023
                    found = torch.autograd.grad(moved, friction)[0].sum() if gradient else moved  # noqa: B023
                # As a number, which waits for a GPU.
                float(found)

            def timed(*, gradient: bool) -> Spread:
                step(gradient=gradient)
                return Spread([seconds_of(lambda: step(gradient=gradient)) for _ in range(rounds)])

            forward, both = timed(gradient=False), timed(gradient=True)
            nodes = len(initial.indices)
            row = {"model": f"`{path.stem}`", "nodes": nodes, "forward [s]": forward, "with gradient [s]": both}
            rows.append(row | {PER_NODE: 1.0e6 * both.median / nodes})
    torch.set_num_threads(threads)
    return rows
