"""The commands that are broken off: small ones of every kind that leaves files from which it goes on."""

import csv
import hashlib
import json
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from datasets.command_line import WorkFailed
from datasets.files import write_text
from datasets.frames import read_arrays

BLOCKS = """
count = 10
split_period = 4
[scene]
duration = { uniform = [0.1, 0.2], step = 0.05 }
[scene.domain]
size = [0.8, 0.4]
cell = 0.02
[scene.material]
friction_deg = { uniform = [20.0, 40.0] }
[[scene.masses]]
lower = [{ uniform = [0.0, 0.2] }, 0.0]
size = [0.2, 0.2]
"""
SCENE = """
duration = 0.25
floor_friction = 0.4
[domain]
size = [0.8, 0.4]
cell = 0.02
[material]
friction_deg = 30.0
[[masses]]
lower = [0.0, 0.0]
size = [0.2, 0.2]
"""
PROBLEM = """
scene = "scene.toml"
surrogate = "none"
[[unknowns]]
name = "friction_deg"
initial = 28.0
lower = 20.0
upper = 40.0
[observation]
kind = "front"
[target]
twin = true
[loop]
mpm_runs = 12
"""
TINY = [
    *("--width", "8", "--layers", "1", "--rounds", "1", "--grid-channels", "4", "--grid-layers", "1"),
    *("--unroll", "1", "--unroll", "2", "--validate-flows", "1", "--device", "cpu"),
    *("--updates", "12", "--validate-updates", "3"),
]
"""Flags of a training of seconds."""
ANSWER = ("verdict", "unknowns", "certainty", "answers", "mpm_runs")
"""Keys of the loop's result that must not depend on how it came about."""

Digest = Mapping[str, str]
"""What a command left, by file or key: equal where the results are."""


@dataclass(frozen=True, kw_only=True)
class Command:
    """A command, which goes on where it was broken off when it is given again."""

    title: str
    arguments: Callable[[Path], list[str]]
    """What to hand to Python, for results in a folder."""
    result: Callable[[Path], Digest]
    """What is to be the same, of the results in a folder."""
    ended: tuple[int, ...] = (0,)
    """Exit statuses of one that came to its end."""


def commands(inputs: Path, scheduler: str) -> dict[str, Command]:
    """Every command by its name; what they read is written to `inputs`. Raises WorkFailed."""
    write_text(inputs / "blocks.toml", BLOCKS)
    write_text(inputs / "scene.toml", SCENE)
    write_text(inputs / "problem.toml", PROBLEM)
    blocks, dataset = str(inputs / "blocks.toml"), inputs / "dataset"
    generate = ["-m", "mpm.generate", blocks]
    if subprocess.run([sys.executable, *generate, "--out", str(dataset)], check=False, capture_output=True).returncode:
        raise WorkFailed("the dataset of the training could not be made")

    def train(out: Path) -> list[str]:
        resume = ["--resume"] if (out / "last.safetensors").exists() else []
        return ["-m", "gns.train", str(dataset), "--out", str(out), *TINY, *resume]

    return {
        "generate": Command(
            title="`mpm.generate --jobs 2`",
            arguments=lambda out: [*generate, "--out", str(out), "--jobs", "2"],
            result=dataset_files,
        ),
        "scheduler": Command(
            title="`mpm.generate --scheduler`, two workers",
            arguments=lambda out: [*generate, "--out", str(out), "--scheduler", scheduler],
            result=dataset_files,
        ),
        "train": Command(title="`gns.train --updates`", arguments=train, result=trained),
        "loop": Command(
            title="`validation.loop`",
            arguments=lambda out: ["-m", "validation.loop", str(inputs / "problem.toml"), "--out", str(out)],
            result=answer,
            ended=(0, 1),
        ),
        "bench": Command(
            title="`validation.bench columns --quick --keep`",
            arguments=lambda out: [
                *("-m", "validation.bench", "columns", "--quick", "--out", str(out), "--keep", str(out / "keep"))
            ],
            result=stored_runs,
        ),
    }


def digest(content: bytes) -> str:
    """Of the contents of a file or an array."""
    return hashlib.sha256(content).hexdigest()


def dataset_files(out: Path) -> Digest:
    """Every file of a dataset but the one that tells how it was made."""
    files = [path for path in sorted(out.rglob("*")) if path.is_file() and path.name != "generation.json"]
    return {str(path.relative_to(out)): digest(path.read_bytes()) for path in files}


def trained(out: Path) -> Digest:
    """The weights of the best model, and the log but for its minutes."""
    from gns.model.checkpoint import read

    tensors, _ = read(out / "best.safetensors")
    with (out / "log.csv").open(newline="") as file:
        rows = [{key: value for key, value in row.items() if key != "minutes"} for row in csv.DictReader(file)]
    weights = {name: digest(value.numpy().tobytes()) for name, value in tensors.items()}
    return weights | {"log": digest(json.dumps(rows).encode())}


def answer(out: Path) -> Digest:
    """What the loop found, and its posterior."""
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    posterior = read_arrays(out / "posterior.npz")
    return {key: json.dumps(timeless(result[key])) for key in ANSWER} | {
        name: digest(array.tobytes()) for name, array in posterior.items()
    }


def stored_runs(out: Path) -> Digest:
    """The positions of every stored run of the MPM, and the tables of the pages."""
    runs = {
        str(path.relative_to(out)): digest(read_arrays(path, "positions")["positions"].tobytes())
        for path in sorted((out / "keep").rglob("*.npz"))
    }
    tables = [line for path in sorted(out.glob("*.md")) for line in path.read_text().splitlines() if line[:1] == "|"]
    return runs | {"tables": digest("\n".join(tables).encode())}


def timeless(value: object) -> object:
    """`value` of a JSON file without its seconds, at any depth."""
    if isinstance(value, dict):
        return {key: timeless(each) for key, each in value.items() if "second" not in key and not key.endswith("_s")}
    if isinstance(value, list):
        return [timeless(each) for each in value]
    return value
