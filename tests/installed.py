"""What an installed Talus does elsewhere, with the files that it ships: `python -P installed.py`."""

from pathlib import Path

import datasets
import gns
import mpm
from datasets.definitions import read_definition
from datasets.scene.library import SCENES, read_scene
from inverse.problem import PROBLEMS, read_problem
from validation.bench.__main__ import main
from validation.experiments.experiment import read_experiments

SOURCE = Path(__file__).resolve().parents[1] / "datasets"
assert not Path(datasets.__file__).is_relative_to(SOURCE), "that is the source tree"
scenes = [read_scene(path.stem) for path in sorted(SCENES.glob("*.toml"))]
problems = [read_problem(path.stem) for path in sorted(PROBLEMS.glob("*.toml"))]
experiments = read_experiments()
models = [gns.load(name) for name in ("flow2d", "obstacle3d")]
assert main(["--help"]) == 0
assert len(read_definition("flow2d").entries(seed=0, count=2)) == 2
front = mpm.simulate(read_scene("column-tall-42"), record=mpm.LAST).summary["front"]
assert 0.3 < front < 1.0, front
print(f"{len(scenes)} scenes, {len(problems)} problems, {len(experiments)} experiments, {len(models)} models")
