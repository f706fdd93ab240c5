"""Valid files, small ones, from which hostile ones are made."""

import dataclasses
import functools
import io
import json
import tempfile
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from datasets.records import from_mapping
from datasets.scene import Scene
from datasets.trajectory import Trajectory

COLUMN: dict[str, Any] = {
    "duration": 0.02,
    "frame_dt": 0.005,
    "gravity": 9.81,
    "floor_friction": 0.4,
    "seed": 3,
    "domain": {"size": [0.4, 0.2], "cell": 0.02},
    "material": {"friction_deg": 30.0, "density": 1800.0, "young": 1.0e6, "poisson": 0.3, "cohesion": 10.0},
    "masses": [{"lower": [0.0, 0.0], "size": [0.1, 0.1], "velocity": [0.1, 0.0]}],
}
SHAPES: dict[str, Any] = COLUMN | {
    "baffles": [{"lower": [0.3, 0.0], "size": [0.02, 0.06], "turned_deg": 10.0, "friction": 0.2}],
    "solids": [
        {"kind": "terrain", "points": [[0.0, 0.02], [0.4, 0.0]], "friction": [0.3, 0.4]},
        {"kind": "polygon", "vertices": [[0.2, 0.0], [0.26, 0.0], [0.23, 0.05]], "adhesion": 5.0},
    ],
    "open_sides": ["x+"],
    "masses": [
        {"kind": "polygon", "vertices": [[0.02, 0.1], [0.1, 0.1], [0.05, 0.18]], "angular_velocity": 1.0},
        {"kind": "layer", "thickness": 0.04, "outline": [[0.0], [0.1]]},
    ],
}
HELD: dict[str, Any] = COLUMN | {
    "masses": [
        {"lower": [0.0, 0.0], "size": [0.1, 0.1], "k0": 0.5, "release": 0.01},
        {
            "kind": "particles",
            "positions": [[0.2, 0.1], [0.22, 0.1]],
            "volume": 1e-4,
            "velocities": [[0.0, 0.0], [1.0, 0.0]],
        },
    ],
    "material": COLUMN["material"] | {"softening_length": 0.01, "residual_friction_deg": 20.0, "dilation_deg": 5.0},
}
SPACE: dict[str, Any] = COLUMN | {
    "domain": {"size": [0.2, 0.2, 0.12], "cell": 0.02},
    "masses": [
        {"lower": [0.0, 0.0, 0.0], "size": [0.06, 0.06, 0.12]},
        {
            "kind": "mesh",
            "vertices": [[0.1, 0.1, 0.02], [0.16, 0.1, 0.02], [0.1, 0.16, 0.02], [0.1, 0.1, 0.08]],
            "triangles": [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
        },
    ],
    "solids": [
        {
            "kind": "terrain",
            "origin": [0.0, 0.0],
            "spacing": [0.1, 0.06],
            "heights": [[0.0, 0.0, 0.0]] * 3,
            "friction": 0.3,
        }
    ],
}
NAMING: dict[str, Any] = SPACE | {
    "solids": [
        {"kind": "terrain", "file": "dem.asc", "at": [0.0, 0.0], "friction": 0.3},
        {"kind": "mesh", "file": "block.stl", "scale": 0.05, "at": [0.15, 0.05, 0.05]},
    ],
    "masses": [{"kind": "particles", "file": "cloud.csv"}],
}
SPARE = (
    {"release": "settled"},
    {"k0": "elastic"},
    {"file": "dem.asc"},
    {"contact": "no-slip"},
    {"unit": "mm"},
    {"name": "a"},
)
SCENES = (COLUMN, SHAPES, HELD, SPACE, NAMING)

UNKNOWN = {"name": "friction_deg", "initial": 30.0, "lower": 12.0, "upper": 52.0}
PROBLEMS: tuple[dict[str, Any], ...] = (
    {
        "scene": "column.toml",
        "unknowns": [UNKNOWN],
        "observation": {"kind": "front"},
        "target": {"value": 0.2, "noise": 0.01},
        "loop": {"mpm_runs": 20, "confirm_within": 0.02},
        "optimiser": {"max_iterations": 5, "seed": 1, "method": "gauss-newton"},
    },
    {
        "scene": "column.toml",
        "unknowns": [
            UNKNOWN | {"step": 0.1},
            {"name": "masses[0].velocity_x", "initial": 0.5, "lower": 0.0, "upper": 1.0},
        ],
        "observation": {"kind": "profile"},
        "target": {"csv": "profile.csv", "unit": "m", "datum": 0.0, "noise": "5%"},
    },
    {
        "scene": "column.toml",
        "unknowns": [UNKNOWN],
        "observations": [
            {"kind": "front", "value": 0.2, "noise": 0.01},
            {"kind": "height", "x": [0.05, 0.1], "values": [0.05, 0.02], "spacing": 0.04, "noise": 0.005},
        ],
    },
    {
        "scene": "column-short-21",
        "unknowns": [UNKNOWN],
        "observation": {"kind": "front"},
        "target": {"twin": True, "seed": 1},
    },
)
DEFINITION: dict[str, Any] = {
    "count": 20,
    "split_period": 5,
    "variables": {"h": {"uniform": [0.05, 0.1], "step": 0.01}},
    "scene": COLUMN
    | {
        "material": {"friction_deg": {"uniform": [20.0, 40.0]}, "cohesion": {"log_uniform": [1.0, 100.0]}},
        "masses": [
            {"count": {"integer": [1, 2]}, "lower": [{"choice": [0.0, 0.2]}, 0.0], "size": [0.1, {"variable": "h"}]}
        ],
    },
}
METADATA: dict[str, Any] = {
    "bounds": [[0.0, 0.4], [0.0, 0.2]],
    "dim": 2,
    "dt": 0.005,
    "dx": 0.01,
    "default_connectivity_radius": 0.02,
    "vel_mean": [0.0, 0.0],
    "vel_std": [1.0, 1.0],
    "acc_mean": [0.0, 0.0],
    "acc_std": [1.0, 1.0],
    "periodic_boundary_conditions": [False, False],
}
DEM = b"ncols 5\nnrows 4\nxllcorner -0.1\nyllcorner -0.1\ncellsize 0.1\nNODATA_value -9999\n" + b"0 0 0 0 0\n" * 4
STL = (
    b"""solid block
"""
    + b"".join(
        b"facet normal 0 0 0\nouter loop\n"
        + b"".join(b"vertex %d %d %d\n" % corner for corner in face)
        + b"endloop\nendfacet\n"
        for face in (
            ((0, 0, 0), (0, 1, 0), (1, 0, 0)),
            ((0, 0, 0), (1, 0, 0), (0, 0, 1)),
            ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
            ((0, 0, 0), (0, 0, 1), (0, 1, 0)),
        )
    )
    + b"endsolid block\n"
)
OBJ = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
CSV = b"x,height,time\n0.0,0.1,0.0\n0.05,0.08,0.01\n0.1,0.02,0.02\n0.15,0.0,0.02\n"
GRID_CSV = b"x,z,y\n0,0,0.1\n0,1,0.2\n1,0,0.1\n1,1,0.3\n"
BESIDE = {
    "dem.asc": DEM,
    "block.stl": STL,
    "cloud.csv": b"x,y,z,volume\n0.1,0.1,0.06,1e-6\n0.12,0.1,0.06,1e-6\n",
    "ground.csv": b"x,y\n0,0\n1,0\n",
    "profile.csv": b"x,height\n0.0,0.08\n0.05,0.07\n0.1,0.05\n0.15,0.03\n0.2,0.0\n",
}


@functools.cache
def scene() -> Scene:
    """The column."""
    return from_mapping(Scene, COLUMN)


@functools.cache
def trajectory() -> dict[str, np.ndarray]:
    """The arrays of a trajectory of eight particles in three frames."""
    with tempfile.TemporaryDirectory() as folder:
        flow().save(Path(folder) / "flow.npz")
        with np.load(Path(folder) / "flow.npz", allow_pickle=False) as file:
            return dict(file)


@functools.cache
def compressed() -> bytes:
    """The same, compressed."""
    with tempfile.TemporaryDirectory() as folder:
        flow().save(Path(folder) / "flow.h5")
        return (Path(folder) / "flow.h5").read_bytes()


def flow() -> Trajectory:
    """A trajectory of eight particles in three frames."""
    count = 8
    return Trajectory(
        positions=np.linspace(0.01, 0.1, 3 * count * 2, dtype=np.float32).reshape(3, count, 2),
        time=np.arange(3) * 0.005,
        velocity0=np.zeros((count, 2), np.float32),
        friction=np.full(count, 0.5, np.float32),
        scene=scene(),
        volume=np.full(count, 1e-4, np.float32),
        mass=np.zeros(count, np.int32),
        pressure=np.ones((3, count), np.float32),
        summary={"front": 0.1},
    )


@functools.cache
def foreign() -> bytes:
    """Another code's NPZ: two trajectories, pickled."""
    one = np.empty(3, object)
    one[0], one[1], one[2] = np.random.default_rng(0).random((4, 6, 2)), np.full(6, 6), np.full(6, 0.5)
    file = io.BytesIO()
    np.savez(file, simulation_0=one, simulation_1=one)
    return file.getvalue()


@functools.cache
def hdf5(compressed: bool = False) -> bytes:
    """Another code's HDF5."""
    file = io.BytesIO()
    with h5py.File(file, "w") as content:
        for index in range(2):
            group = content.create_group(f"{index:05d}")
            more = {"compression": "gzip", "chunks": (2, 6, 2)} if compressed else {}
            group.create_dataset("position", data=np.random.default_rng(index).random((4, 6, 2), np.float32), **more)
            group["particle_type"] = np.zeros(6, np.int32)
            group["material_property"] = np.full(6, 0.5, np.float32)
    return file.getvalue()


@functools.cache
def tiff() -> bytes:
    """A GeoTIFF."""
    import rasterio
    from rasterio.io import MemoryFile

    with MemoryFile() as memory:
        profile = {"driver": "GTiff", "width": 5, "height": 4, "count": 1, "dtype": "float32"}
        with memory.open(**profile, transform=rasterio.Affine(0.1, 0, -0.1, 0, -0.1, 0.3)) as file:
            file.write(np.zeros((1, 4, 5), np.float32))
        return bytes(memory.read())


@functools.cache
def meshes() -> dict[str, bytes]:
    """A tetrahedron in some formats, by their endings."""
    import meshio

    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    mesh = meshio.Mesh(points, [("triangle", np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], np.int32))])
    found = {".stl": STL, ".obj": OBJ}
    with tempfile.TemporaryDirectory() as folder:
        for ending, kind in (
            *(
                (".ply", "ply"),
                (".vtk", "vtk"),
                (".vtu", "vtu"),
                (".off", "off"),
                (".msh", "gmsh"),
                ("2.msh", "gmsh22"),
            ),
            *((".mesh", "medit"), (".nas", "nastran")),
        ):
            with redirect_stdout(io.StringIO()):
                mesh.write(Path(folder) / f"mesh{ending}", file_format=kind)
            found[ending] = (Path(folder) / f"mesh{ending}").read_bytes()
        meshio.stl.write(Path(folder) / "binary.stl", mesh, binary=True)
        found["binary.stl"] = (Path(folder) / "binary.stl").read_bytes()
    return found


@functools.cache
def model() -> bytes:
    """A tiny model."""
    import torch

    from gns.model import checkpoint
    from gns.model.settings import ModelSettings
    from gns.model.simulator import Normalisation, Simulator

    torch.manual_seed(0)
    settings = ModelSettings(history=2, width=8, layers=1, rounds=1, grid_channels=4, grid_layers=1, body_length=0.2)
    scales = Normalisation(displacement=3e-3, acceleration=7e-4, friction_mean=0.6, friction_std=0.2)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.safetensors"
        checkpoint.save(path, Simulator(settings, scales), {"command": "none", "datasets": []})
        return path.read_bytes()


@functools.cache
def run() -> bytes:
    """A training in progress, of the same tiny model."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "last.safetensors"
        new_run().save(path)
        return path.read_bytes()


def new_run() -> Any:
    """A training at its beginning."""
    import torch

    from gns.model.settings import ModelSettings
    from gns.model.simulator import Normalisation, Simulator
    from gns.training.update import Run, TrainingSettings

    torch.manual_seed(0)
    settings = ModelSettings(history=2, width=8, layers=1, rounds=1, grid_channels=4, grid_layers=1, body_length=0.2)
    scales = Normalisation(displacement=3e-3, acceleration=7e-4, friction_mean=0.6, friction_std=0.2)
    return Run(Simulator(settings, scales), TrainingSettings(), seed=0)


@functools.cache
def state() -> dict[str, np.ndarray]:
    """The arrays of a checkpoint of the MPM."""
    from mpm.arrays.batch import Batch
    from mpm.output.checkpoint import Checkpoint

    batch = Batch([scene()], precision="f32")
    batch.computed = 1
    with tempfile.TemporaryDirectory() as folder:
        Checkpoint.from_batch(batch, wall_s=1.0).save(Path(folder) / "checkpoint.npz")
        with np.load(Path(folder) / "checkpoint.npz", allow_pickle=False) as file:
            return dict(file)


def card() -> dict[str, Any]:
    """The card that ships with a model."""
    path = Path(__file__).parents[2] / "gns" / "weights" / "flow2d.json"
    return dict(json.loads(path.read_text()))


def parsed(data: bytes) -> tuple[dict[str, Any], bytes]:
    """Header and tensors of safetensors."""
    size = int.from_bytes(data[:8], "little")
    return json.loads(data[8 : 8 + size]), data[8 + size :]


def joined(header: dict[str, Any], tensors: bytes) -> bytes:
    """As safetensors."""
    text = json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + tensors


def settings_of(data: bytes) -> dict[str, Any]:
    """The settings in the metadata of a model."""
    return dict(json.loads(parsed(data)[0]["__metadata__"]["settings"]))


def with_settings(data: bytes, settings: dict[str, Any]) -> bytes:
    """A model that states other settings."""
    header, tensors = parsed(data)
    header["__metadata__"]["settings"] = json.dumps(settings)
    return joined(header, tensors)


def plain_scene(**changes: Any) -> Scene:
    """The column with other values."""
    return dataclasses.replace(scene(), **changes)
