"""talus COMMAND ...: the commands of all packages under one name; `python -m MODULE` calls the same functions."""

import re
import sys
from collections.abc import Sequence
from pathlib import Path

from datasets.command_line import run
from datasets.files import read_toml
from datasets.scene.library import SCENES, find

COMMANDS = {
    "site": ("datasets.site:command", "write a scene from a raster of elevations and a release polygon"),
    "run": ("mpm.run:command", "simulate a scene with the MPM"),
    "generate": ("mpm.generate:command", "make a dataset of MPM runs"),
    "train": ("gns.train:train", "train a surrogate"),
    "rollout": ("gns.rollout:rollout", "predict a scene with a surrogate"),
    "score": ("gns.score:score", "measure the errors of a surrogate on a dataset"),
    "adapt": ("inverse.adapt:main", "train a surrogate for one inverse problem"),
    "invert": ("inverse.__main__:main", "solve an inverse problem with one forward model"),
    "solve": ("validation.loop.__main__:main", "solve an inverse problem; the MPM confirms the answer"),
    "design": ("validation.design.__main__:main", "find where barriers stand so that a limit is kept"),
    "forecast": ("validation.forecast.__main__:main", "carry the answer of an inversion to another scene"),
    "view": ("validation.view:command", "write one or two flows as an HTML page"),
    "vtk": ("validation.vtk:command", "convert a flow for ParaView, draw a picture"),
    "compare": ("datasets.compare:command", "compare two flows: fronts, profiles, energies"),
    "maps": ("datasets.maps:command", "write thickness, depth and velocity of a flow as rasters"),
    "forces": ("datasets.forces:command", "write the force on each solid over time"),
    "exchange": ("datasets.exchange.__main__:command", "convert datasets to and from the format of another code"),
    "demo": ("validation.demo:main", "find a secret friction angle from the front of a deposit"),
    "bench": ("validation.bench.__main__:PAGES", "measure again what a page of the documentation shows"),
    "scenes": ("validation.talus:scenes", "list the scenes that ship"),
    "problems": ("validation.talus:problems", "list the inverse problems that ship"),
    "designs": ("validation.talus:designs", "list the design problems that ship"),
}
PROBLEMS = Path(__file__).parents[1] / "inverse" / "problems"
DESIGNS = Path(__file__).parent / "design" / "problems"
SENTENCE = re.compile(r"(?<=[.?]) (?=[^a-z])")  # between two sentences


def scenes() -> str:
    """List the scenes that ship: name, dimension, what it is."""
    return listed(SCENES)


def problems() -> str:
    """List the inverse problems that ship: name, dimension, what is to be found."""
    return listed(PROBLEMS)


def designs() -> str:
    """List the design problems that ship: name, dimension, what is to be found."""
    return listed(DESIGNS)


def listed(folder: Path) -> str:
    """A line for each file of a folder: name, dimension, the first sentence of its comment."""
    lines = []
    for path in sorted(folder.glob("*.toml"), key=lambda path: path.stem):
        table = read_toml(path)
        scene = table.get("scene", table)
        if isinstance(scene, str):
            scene = read_toml(find(scene, SCENES, "scene"))
        comment = re.match(r"(?:#.*\n)*", path.read_text(encoding="utf-8"))
        assert comment is not None, "it may be empty"
        text = " ".join(line.lstrip("# ") for line in comment[0].splitlines())
        lines.append(f"{path.stem:28s} {len(scene['domain']['size'])}D  {SENTENCE.split(text)[0].rstrip('.')}")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command that is named on the command line, and return its exit status."""
    return run(COMMANDS, "talus", arguments)


if __name__ == "__main__":
    sys.exit(main())
