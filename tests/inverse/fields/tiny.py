"""A tiny problem with two fields, in files and read: a block of 48 particles that slides for a tenth of a second."""

from pathlib import Path

from inverse.fields.problem import FieldProblem, read_problem

SCENE = """
duration = 0.1
frame_dt = 0.005
floor_friction = 0.3
step_fraction = 0.9
[domain]
size = [0.6, 0.2]
cell = 0.02
[material]
friction_deg = 30.0
young = 1.0e5
cohesion = 200.0
tension_cutoff = 100.0
[[masses]]
lower = [0.1, 0.0]
size = [0.12, 0.04]
velocity = [0.5, 0.0]
[[fields]]
quantity = "friction_deg"
origin = [0.1, 0.0]
spacing = [0.06, 0.04]
nodes = [3, 2]
values = [35.0, 35.0, 30.0, 30.0, 20.0, 20.0]
[[fields]]
quantity = "velocity_x"
origin = [0.1, 0.0]
spacing = [0.12, 0.04]
nodes = [2, 1]
values = [0.4, 0.9]
"""
PROBLEM = """
scene = "scene.toml"
[[fields]]
quantity = "friction_deg"
spacing = [0.02, 0.02]
mean = 28.0
deviation = 5.0
length = 0.06
lower = 10.0
upper = 45.0
[[fields]]
quantity = "velocity_x"
spacing = [0.02, 1.0]
mean = 0.6
deviation = 0.3
length = 0.06
[[observations]]
kind = "profile"
spacing = 0.01
times = [0.0525]
noise = 0.0005
[[observations]]
kind = "height"
x = [0.2, 0.24]
times = [0.05, 0.1]
noise = 0.0005
[target]
twin = true
[search]
seeds = 2
ensemble = 6
iterations = 2
"""


def files(folder: Path, problem: str = PROBLEM, scene: str = SCENE) -> str:
    """Write both, and return the path of the problem."""
    (folder / "scene.toml").write_text(scene)
    (folder / "problem.toml").write_text(problem)
    return str(folder / "problem.toml")


def tiny(folder: Path) -> FieldProblem:
    """The problem."""
    return read_problem(files(folder))
