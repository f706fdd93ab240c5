"""The arrays that kernels take, named once in this table for batch, kernels and adjoint."""

import linecache
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from mpm.arrays.features import NODE, Features
from mpm.arrays.layout import ALIGNMENT, Address

Kind = tuple[str, int]  # element and rank of an array


def named(**groups: str) -> dict[str, Kind]:
    """Kind of each array by its name, from the names of each kind; a table has rank 2.

    A block is a vector of lanes, a node a short vector of `Features.node` numbers; a lane is a single number of such
    blocks, in a second view of their memory."""
    kinds = {kind: (kind.removesuffix("_table"), 1 + kind.endswith("_table")) for kind in groups}
    return {name: kinds[kind] for kind, names in groups.items() for name in names.split()}


STEP = named(
    block="state scratch impulse",
    lane="lanes scratch_lanes impulse_lanes",
    node="grid cells rows",
    real="cell_distance terrain column_heights drag_posts",
    real_table="settings properties faces holds drags inflows",
    i32="cell_faces near_faces node_holds covered arrivals bases",
    i32_table="offsets workers spans beside barriers retained drag_places",
    f64_table="settling",
    i64="addresses",
)
"""The arrays of a step, forwards and in its adjoint; attributes of `mpm.arrays.batch.Batch`."""
RECORD = named(i32="order", f32="positions", f64="energy", f64_table="recorded_impulse")  # for the end of a frame
DEVICE = named(i32="owner", real_table="step_control")  # only for a GPU
ADJOINT = named(
    block="adjoints history",
    lane="adjoint_lanes history_lanes",
    node="kept grid_adjoints",
    real="impulse_adjoints",
    real_table="cuts step_times",
    i32="step_counts",
    f64_table="face_adjoints hold_adjoints terrain_adjoints drag_adjoints sums",
)
"""Arrays of the adjoint besides `STEP`; `mpm.adjoint.tape` makes them."""
VIEWS = {"lanes": "state", "scratch_lanes": "scratch", "impulse_lanes": "impulse", "rows": "scratch"}
VIEWS |= {"adjoint_lanes": "adjoints", "history_lanes": "history"}
"""Arrays that are views, with the owner of their memory."""


@ti.data_oriented
class Arrays:
    """The arrays of a kernel by name, as its functions pass them on, with its compile-time constants."""

    def __init__(self, **named: Any) -> None:
        vars(self).update(named)


def arguments(arrays: Mapping[str, Kind], memory: Mapping[str, Any], lanes: int) -> dict[str, Any]:
    """The arrays of a table in its order and in the shape that a kernel takes, from NumPy arrays by name."""
    addresses = np.array([memory[address.name.lower()].ctypes.data for address in Address])
    reshaped = {}
    for name, (element, rank) in arrays.items():
        array = addresses if name == "addresses" else memory[VIEWS.get(name, name)]
        if element == "block" and lanes > 1:
            array = array.reshape(-1, lanes)
        elif element == "node" and name in VIEWS:
            array = array.reshape(-1)[: array.size // NODE * NODE].reshape(-1, NODE)
        elif element != "node" and rank == 1:
            array = array.reshape(-1)
        reshaped[name] = array
    return reshaped


def aligned(shape: tuple[int, ...], real: np.dtype[Any]) -> NDArray[Any]:
    """Zeros that begin at a multiple of ALIGNMENT bytes."""
    size = math.prod(shape) * real.itemsize
    memory = np.zeros(size + ALIGNMENT, np.uint8)
    offset = -memory.ctypes.data % ALIGNMENT
    return memory[offset : offset + size].view(real).reshape(shape)


def kernel_of(
    arrays: Mapping[str, Kind], body: Callable[..., None], features: Features, *, optimised: bool, **constants: Any
) -> Callable[..., None]:
    """A kernel with the parameters `arrays`, `first`, `last` and `phase`, which it hands to the Taichi function `body`.

    body: of an `Arrays` that holds `features` and `constants` too, `first`, `last` and `phase`.
    optimised: whether Taichi simplifies the kernel before LLVM does, which takes half of the compilation. The results
    are the same to the bit. The gain is a tenth of a dry step: loops do not look up the addresses of arrays."""
    real = ti.f32 if features.precision == "f32" else ti.f64
    block = real if features.processor.gpu else ti.types.vector(features.lanes, real)
    elements = {"block": block, "lane": real, "node": ti.types.vector(NODE, real), "real": real}
    # Taichi 1.7.4 reads a kernel's parameters in its source, refuses *args, and takes no NumPy array inside another:
    # a plain signature would name each of these 40 and 49 parameters three times.
    # `ti.static` makes the object while the kernel is compiled.
    source = (
        f"def run({', '.join(arrays)}, first, last, phase):\n"
        f"    arrays = ti.static([Arrays({', '.join(f'{name}={name}' for name in arrays)}, **constants)])[0]\n"
        "    body(arrays, first, last, phase)\n"
    )
    file = f"<kernel {body.__module__}>"
    linecache.cache[file] = len(source), None, source.splitlines(keepends=True), file
    scope = {"ti": ti, "Arrays": Arrays, "body": body, "constants": {"features": features, **constants}}
    exec(compile(source, file, "exec"), scope)
    run: Any = scope["run"]
    elements |= {name: getattr(ti, name) for name in ("i32", "i64", "f32", "f64")}
    types = {name: ti.types.ndarray(elements[element], rank) for name, (element, rank) in arrays.items()}
    run.__annotations__ = types | {"first": ti.i32, "last": ti.i32, "phase": ti.template()}
    compiled: Callable[..., None] = ti.kernel(run)

    def launch(*values: Any) -> None:
        ti.cfg.advanced_optimization = optimised
        compiled(*values)

    return launch
