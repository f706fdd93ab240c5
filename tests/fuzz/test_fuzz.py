"""Hostile files: each ends in one line, soon, in little memory, and nothing that is wrong is accepted.

A process of its own reads them (`tests.fuzz.worker`), so that one that hangs or dies is a finding like any other.
`make fuzz` makes tens of thousands; here are some hundred, always the same.
"""

import json
import tempfile

import pytest
from hypothesis import HealthCheck, given, settings

from tests.fuzz import mutations, seeds
from tests.fuzz.asking import Worker
from tests.fuzz.corpus import corpus
from tests.fuzz.kinds import KINDS

QUICK = 700
"""Files of all families in `make test`."""


def fuzz(worker: Worker, kind: str, count: int, *, repeatable: bool) -> None:
    """Hand so many files of a kind to the worker; every place where one fell is shown with its shortest file."""
    known = KINDS[kind]

    @settings(
        max_examples=count,
        deadline=None,
        database=None,
        derandomize=repeatable,
        suppress_health_check=list(HealthCheck),
    )
    @given(known.cases())
    def each(case: tuple[str, bytes]) -> None:
        worker.hand_over(kind, *case, beside=known.beside)

    each()
    worker.drain()
    fallen = worker.tallies[kind].fallen
    for text, content in fallen.values():
        with tempfile.NamedTemporaryFile(prefix=f"talus-fell-{kind}-", delete=False) as file:
            file.write(content)
        print(f"{file.name}: {text}")
    assert not fallen, "\n".join(text for text, _ in fallen.values())


@pytest.mark.parametrize("kind", [name for name in KINDS if name != "simulated"])
def test_some(worker: Worker, kind: str) -> None:
    fuzz(worker, kind, round(QUICK * KINDS[kind].share / sum(each.share for each in KINDS.values())), repeatable=True)


@pytest.mark.fuzz
# Of the files that cases are made from, some are long.
@pytest.mark.filterwarnings("ignore:Generating overly large repr")
@pytest.mark.parametrize("kind", KINDS)
def test_many(worker: Worker, kind: str, request: pytest.FixtureRequest) -> None:
    count = request.config.getoption("--fuzz")
    fuzz(worker, kind, max(1, round(count * KINDS[kind].share)), repeatable=False)


@pytest.mark.parametrize("kind", corpus())
def test_what_once_fell(worker: Worker, kind: str) -> None:
    outcomes = {
        what: worker.ask(kind, name, content, KINDS[kind].beside) for what, (name, content) in corpus()[kind]().items()
    }
    assert {what: text for what, (outcome, text) in outcomes.items() if outcome != "refused"} == {}


def valid() -> dict[str, list[tuple[str, bytes]]]:
    """Names and contents of the files from which hostile ones are made, by kind."""
    return {
        "scene": [("scene.toml", mutations.toml(base)) for base in seeds.SCENES],
        "problem": [("problem.toml", mutations.toml(base)) for base in seeds.PROBLEMS],
        "definition": [("mine.toml", mutations.toml(seeds.DEFINITION))],
        "trajectory": [("flow.npz", mutations.npz(seeds.trajectory(), compressed=each)) for each in (False, True)],
        "compressed": [("flow.h5", seeds.compressed())],
        "foreign": [("train.npz", seeds.foreign())],
        "hdf5": [("train.h5", seeds.hdf5(compressed=each)) for each in (False, True)],
        "metadata": [("metadata.json", json.dumps(seeds.METADATA).encode())],
        "raster": [("dem.asc", seeds.DEM), ("dem.tif", seeds.tiff()), ("dem.csv", seeds.GRID_CSV)],
        "mesh": [(f"mesh.{ending.rpartition('.')[2]}", content) for ending, content in seeds.meshes().items()],
        "csv": [("profile.csv", seeds.CSV), ("ground.csv", seeds.BESIDE["ground.csv"])],
        "model": [("model.safetensors", seeds.model())],
        "card": [("model.json", json.dumps(seeds.card()).encode())],
        "run": [("last.safetensors", seeds.run())],
        "state": [("checkpoint.npz", mutations.npz(seeds.state()))],
        "simulated": [("scene.toml", mutations.toml(seeds.COLUMN))],
    }


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_valid_is_accepted(worker: Worker, kind: str) -> None:
    for name, content in valid()[kind]:
        outcome, text = worker.ask(kind, name, content, KINDS[kind].beside)
        assert outcome == "accepted", f"{name}: {text}"
