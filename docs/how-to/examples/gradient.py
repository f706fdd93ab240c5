"""How fast was a column thrown? A loss of one's own on the MPM's deposit, and its gradient by the MPM's adjoint."""

import dataclasses

import torch

from datasets import read_scene
from inverse.forward.adjoint import AdjointRun

scene = dataclasses.replace(read_scene("column-short-21"), duration=0.3).with_cell(0.02)
run = AdjointRun(scene, names=("friction_deg", "masses[0].velocity_x"))


def loss(parameters: torch.Tensor) -> torch.Tensor:
    """Squared distance [m^2] of the mean x of the particles from where it was seen after 0.3 s."""
    positions, _ = run(parameters)  # and velocities; [m], [m/s], shape (1, N, 2): the last frame
    return (positions[-1, :, 0].mean() - 0.45) ** 2


parameters = torch.tensor([30.0, 0.5], dtype=torch.float64, requires_grad=True)
first = loss(parameters)
first.backward()
slope = parameters.grad
print(f"loss {first.item():.2e} m^2, slopes {slope[0].item():.2e} per degree and {slope[1].item():.2e} per m/s")
with torch.no_grad():
    step = torch.tensor([0.0, 0.05], dtype=torch.float64)
    difference = ((loss(parameters + step) - loss(parameters - step)) / 0.1).item()
print(f"by two more runs {difference:.2e} per m/s")
assert abs(slope[1].item() / difference - 1.0) < 0.1
assert slope[0] > 0.0 > slope[1]  # friction holds it back from there, speed brings it there

velocity = 0.5
for _ in range(3):  # Newton's method for the root of the distance: d sqrt(L) = dL / (2 sqrt(L))
    found = torch.tensor([30.0, velocity], dtype=torch.float64, requires_grad=True)
    value = loss(found)
    value.backward()
    velocity -= 2.0 * value.item() / found.grad[1].item()
    print(f"loss {value.item():.1e} m^2; next {velocity:.3f} m/s")
assert value < first / 100.0
