"""The kinds of files that come from outside: how hostile ones are made, and what reads them."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

from tests.fuzz import mutations, seeds


@dataclass(frozen=True, kw_only=True)
class Kind:
    """One kind of file."""

    read: Callable[[Path], object]
    """In the worker: reads the file as a command would, and runs what is small."""
    cases: Callable[[], st.SearchStrategy[tuple[str, bytes]]]
    """Names and contents."""
    share: float
    """Of the cases of a run of the fuzzer."""
    beside: dict[str, bytes] | None = None
    """Files that the file may name."""


def read_scene(path: Path) -> None:
    from datasets.library import read_scene
    from datasets.particles import warn_if_unresolved
    from mpm.arrays.batch import Batch
    from mpm.footprint import footprint, require_memory

    scene = read_scene(path)
    assert scene == type(scene).from_json(scene.to_json())
    plan = footprint(scene)
    require_memory([plan])
    warn_if_unresolved(scene)
    batch = Batch([scene], precision="f32")
    assert np.isfinite(batch.state).all()
    assert len(batch.particles[0].positions) == plan.particles
    assert (batch.particles[0].volume > 0.0).all()


def run_scene(path: Path) -> None:
    from datasets.library import read_scene
    from mpm import LAST, simulate
    from mpm.footprint import footprint

    scene = read_scene(path)
    plan = footprint(scene)
    if plan.particles * plan.steps < 2.0e6 and plan.steps < 20_000:
        flow = simulate(scene, record=LAST)
        assert np.isfinite(flow.positions).all()


def read_problem(path: Path) -> None:
    from inverse.observations.reading import read_each
    from inverse.problem import read_problem

    problem = read_problem(str(path))
    read_each(problem)
    problem.scene_at(problem.initial)


def read_definition(path: Path) -> None:
    from datasets.definitions import read_definition

    read_definition(str(path)).entries(seed=0, count=2)


def read_trajectory(path: Path) -> None:
    from datasets import measures
    from datasets.training.memory_mapped import open_trajectory
    from datasets.trajectory import Trajectory, stored_scene

    flow = Trajectory.load(path)
    stored_scene(path)
    open_trajectory(path)
    assert np.isfinite(measures.front(flow.positions[-1]))
    assert np.isfinite(flow.volumes).all()


def read_foreign(path: Path) -> None:
    from datasets.exchange import geoelements

    list(geoelements.read(path, geoelements.names(path)))


def read_hdf5(path: Path) -> None:
    from datasets.exchange import lagrangebench

    list(lagrangebench.read(path, lagrangebench.names(path)))


def read_metadata(path: Path) -> None:
    from datasets.exchange.cloud import ForeignMetadata, Statistics, known_keys, read_metadata

    data = read_metadata(path)
    known_keys(ForeignMetadata, data, path)
    known_keys(Statistics, data, path)


def read_model(path: Path) -> None:
    from gns import card
    from gns.inference import load, simulate

    simulator = load(path)
    card.read(path)
    flow = simulate(seeds.scene(), model=simulator)
    assert np.isfinite(flow.positions).all()


def read_card(path: Path) -> None:
    from gns import card

    card.warning(path.with_suffix(".safetensors"), seeds.scene())


def read_run(path: Path) -> None:
    run = seeds.new_run()
    run.resume(path)
    assert run.position.updates >= 0


def read_state(path: Path) -> None:
    from mpm.arrays.batch import Batch
    from mpm.output.checkpoint import Checkpoint

    start = Checkpoint.load(path)
    batch = Batch([seeds.scene()], precision=start.features.precision, record=start.recording)
    start.restore(batch)
    assert np.isfinite(batch.state).all()


def read_raster(path: Path) -> None:
    from datasets.geometry.rasters import read_field

    read_field(path, "y", extra="friction").cropped((0.2, 0.12), 0.1)


def read_mesh(path: Path) -> None:
    from datasets.geometry.meshes import read_mesh
    from datasets.geometry.spatial import outward

    vertices, triangles = read_mesh(path)
    outward(vertices, triangles, "triangles")


def read_csv(path: Path) -> None:
    from datasets.geometry.files import ground_line
    from inverse.observations.measured_profile import read_columns

    if path.stem == "ground":
        ground_line(path, {})
    else:
        columns = read_columns(path, ("x", "height"), optional=("time",))
        assert all(np.isfinite(column).all() for column in columns)


def named(name: str, contents: st.SearchStrategy[bytes]) -> st.SearchStrategy[tuple[str, bytes]]:
    return st.tuples(st.just(name), contents)


def scene_files() -> st.SearchStrategy[tuple[str, bytes]]:
    wholes = tuple(mutations.toml(each) for each in seeds.SCENES)
    made = mutations.tables(seeds.SCENES, seeds.SPARE).map(mutations.toml)
    return named("scene.toml", st.one_of(made, made, made, mutations.damaged(wholes)))


def problem_files() -> st.SearchStrategy[tuple[str, bytes]]:
    wholes = tuple(mutations.toml(each) for each in seeds.PROBLEMS)
    made = mutations.tables(seeds.PROBLEMS).map(mutations.toml)
    return named("problem.toml", st.one_of(made, made, made, mutations.damaged(wholes)))


def definition_files() -> st.SearchStrategy[tuple[str, bytes]]:
    return named("mine.toml", mutations.tables((seeds.DEFINITION,)).map(mutations.toml))


def json_files(name: str, base: dict[str, Any]) -> st.SearchStrategy[tuple[str, bytes]]:
    made = mutations.tables((base,)).map(lambda data: json.dumps(data).encode("utf-8", "surrogatepass"))
    return named(name, st.one_of(made, mutations.damaged((json.dumps(base).encode(),))))


def npz_files(name: str, base: dict[str, np.ndarray]) -> st.SearchStrategy[tuple[str, bytes]]:
    wholes = mutations.npz(base), mutations.npz(base, compressed=True)
    made = mutations.arrays(base).map(mutations.npz)
    members = mutations.archives((mutations.members_of(wholes[0]),))
    return named(name, st.one_of(made, made, members, mutations.damaged(wholes)))


def foreign_files() -> st.SearchStrategy[tuple[str, bytes]]:
    whole = seeds.foreign()
    return named("train.npz", mutations.archives((mutations.members_of(whole),)) | mutations.damaged((whole,)))


def hdf5_files() -> st.SearchStrategy[tuple[str, bytes]]:
    return named("train.h5", mutations.damaged((seeds.hdf5(), seeds.hdf5(compressed=True))))


def model_files() -> st.SearchStrategy[tuple[str, bytes]]:
    whole = seeds.model()
    header, tensors = seeds.parsed(whole)
    settings = mutations.tables((seeds.settings_of(whole),)).map(lambda data: seeds.with_settings(whole, data))
    headers = mutations.tables((header,)).map(lambda data: seeds.joined(data, tensors))
    return named(
        "model.safetensors",
        st.one_of(settings, settings, headers, weights(header, tensors), mutations.damaged((whole,))),
    )


@st.composite
def weights(draw: st.DrawFn, header: dict[str, Any], tensors: bytes) -> bytes:
    """Tensors of other numbers."""
    numbers = np.frombuffer(tensors, np.float32).copy()
    value = draw(st.sampled_from((np.nan, np.inf, 3e38, -3e38, 1e20, 1e10, 0.0, -1.0)))
    index = draw(st.integers(0, len(numbers) - 1))
    numbers[index : index + draw(st.sampled_from((1, 100, 10**6)))] = value
    return seeds.joined(header, numbers.tobytes())


def run_files() -> st.SearchStrategy[tuple[str, bytes]]:
    whole = seeds.run()
    header, tensors = seeds.parsed(whole)
    described = json.loads(header["__metadata__"]["run"])

    def stated(data: dict[str, Any]) -> bytes:
        metadata = {**header["__metadata__"], "run": json.dumps(data)}
        return seeds.joined({**header, "__metadata__": metadata}, tensors)

    made = mutations.tables((described,)).map(stated)
    headers = mutations.tables((header,)).map(lambda data: seeds.joined(data, tensors))
    return named("last.safetensors", st.one_of(made, headers, mutations.damaged((whole,))))


def raster_files() -> st.SearchStrategy[tuple[str, bytes]]:
    return st.one_of(
        named("dem.asc", mutations.damaged((seeds.DEM,))),
        named("dem.tif", mutations.damaged((seeds.tiff(),))),
        named("dem.csv", mutations.damaged((seeds.GRID_CSV,))),
    )


def mesh_files() -> st.SearchStrategy[tuple[str, bytes]]:
    return st.one_of(
        *(
            named(f"mesh.{name.rpartition('.')[2]}", mutations.damaged((whole,)))
            for name, whole in seeds.meshes().items()
        )
    )


def csv_files() -> st.SearchStrategy[tuple[str, bytes]]:
    return named("profile.csv", mutations.damaged((seeds.CSV,))) | named(
        "ground.csv", mutations.damaged((seeds.BESIDE["ground.csv"],))
    )


KINDS = {
    "scene": Kind(read=read_scene, cases=scene_files, share=0.6, beside=seeds.BESIDE),
    "problem": Kind(
        read=read_problem,
        cases=problem_files,
        share=0.3,
        beside=seeds.BESIDE | {"column.toml": mutations.toml(seeds.COLUMN)},
    ),
    "definition": Kind(read=read_definition, cases=definition_files, share=0.1),
    "trajectory": Kind(read=read_trajectory, cases=lambda: npz_files("flow.npz", seeds.trajectory()), share=0.2),
    "compressed": Kind(
        read=read_trajectory, cases=lambda: named("flow.h5", mutations.damaged((seeds.compressed(),))), share=0.1
    ),
    "foreign": Kind(read=read_foreign, cases=foreign_files, share=0.2),
    "hdf5": Kind(read=read_hdf5, cases=hdf5_files, share=0.2),
    "metadata": Kind(read=read_metadata, cases=lambda: json_files("metadata.json", seeds.METADATA), share=0.05),
    "model": Kind(read=read_model, cases=model_files, share=0.1),
    "card": Kind(read=read_card, cases=lambda: json_files("model.json", seeds.card()), share=0.05),
    "run": Kind(read=read_run, cases=run_files, share=0.05),
    "state": Kind(read=read_state, cases=lambda: npz_files("checkpoint.npz", seeds.state()), share=0.05),
    "raster": Kind(read=read_raster, cases=raster_files, share=0.2),
    "mesh": Kind(read=read_mesh, cases=mesh_files, share=0.2),
    "csv": Kind(read=read_csv, cases=csv_files, share=0.2),
    "simulated": Kind(
        read=run_scene,
        cases=lambda: named("scene.toml", mutations.tables((seeds.COLUMN,)).map(mutations.toml)),
        share=0.01,
    ),
}
"""By name; shares of scenes, problems and definitions come to one, each of the others to a fifth by family."""
