"""The arrays that kernels take, each named here once: batch, kernels and adjoint have theirs from this table."""

import linecache
import math
from collections.abc import Callable, Mapping
from enum import Enum
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from mpm.arrays.features import NODE, Features
from mpm.arrays.layout import ALIGNMENT, Address


class ArrayKind(Enum):
    """Element and rank of an array; a block is a vector of lanes, a node a short one of `Features.node` numbers."""

    BLOCKS = "block", 1
    LANES = "lane", 1  # the numbers of such vectors: a second view of the memory of BLOCKS
    NODES = "node", 1
    REAL = "real", 1
    REAL_TABLE = "real", 2
    INTEGER = "i32", 1
    INTEGER_TABLE = "i32", 2
    LONG = "i64", 1
    SINGLE = "f32", 1
    DOUBLE = "f64", 1
    DOUBLE_TABLE = "f64", 2


def named(**groups: str) -> dict[str, ArrayKind]:
    """Kinds by the names of arrays, from the names of each kind."""
    return {name: ArrayKind[kind] for kind, names in groups.items() for name in names.split()}


STEP = named(
    BLOCKS="state scratch impulse",
    LANES="lanes scratch_lanes impulse_lanes",
    NODES="grid cells rows",
    REAL="cell_distance terrain column_heights drag_posts",
    REAL_TABLE="settings properties faces holds drags inflows",
    INTEGER="cell_faces near_faces node_holds covered arrivals bases",
    INTEGER_TABLE="offsets workers spans beside barriers retained drag_places",
    DOUBLE_TABLE="settling",
    LONG="addresses",
)
"""What a step reads and writes, forwards and in its adjoint; attributes of `mpm.arrays.batch.Batch`."""
RECORD = named(INTEGER="order", SINGLE="positions", DOUBLE="energy", DOUBLE_TABLE="recorded_impulse")
"""What the end of a frame reads and writes besides."""
DEVICE = named(INTEGER="owner", REAL_TABLE="step_control")  # what only a GPU reads and writes
ADJOINT = named(
    BLOCKS="adjoints history",
    LANES="adjoint_lanes history_lanes",
    NODES="kept grid_adjoints",
    REAL="impulse_adjoints",
    REAL_TABLE="cuts step_times",
    INTEGER="step_counts",
    DOUBLE_TABLE="face_adjoints hold_adjoints terrain_adjoints drag_adjoints sums",
)
"""What the adjoint reads and writes besides `STEP`; `mpm.adjoint.tape` makes them."""
VIEWS = {
    "lanes": "state",
    "scratch_lanes": "scratch",
    "impulse_lanes": "impulse",
    "adjoint_lanes": "adjoints",
    "history_lanes": "history",
    "rows": "scratch",
}
"""The arrays of LANES: of whose memory each is a view."""


@ti.data_oriented
class Arrays:
    """The arrays of a kernel by name, as its functions pass them on, with what it was compiled for."""

    def __init__(self, **named: Any) -> None:
        vars(self).update(named)


def arguments(arrays: Mapping[str, ArrayKind], memory: Mapping[str, Any], lanes: int) -> dict[str, Any]:
    """The arrays of a table in its order and in the shape that a kernel takes, from NumPy arrays by name."""
    addresses = np.array([memory[address.name.lower()].ctypes.data for address in Address])
    reshaped = {}
    for name, kind in arrays.items():
        array = addresses if kind is ArrayKind.LONG else memory[VIEWS.get(name, name)]
        if kind is ArrayKind.BLOCKS and lanes > 1:
            array = array.reshape(-1, lanes)
        elif kind is ArrayKind.NODES and name in VIEWS:
            array = array.reshape(-1)[: array.size // NODE * NODE].reshape(-1, NODE)
        elif kind is not ArrayKind.NODES and kind.value[1] == 1:
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
    arrays: Mapping[str, ArrayKind], body: Callable[..., None], features: Features, **constants: Any
) -> Callable[..., None]:
    """A kernel with the parameters `arrays`, `first`, `last` and `phase`, which it hands to the Taichi function `body`.

    body: of an `Arrays` that holds `features` and `constants` too, `first`, `last` and `phase`.
    """
    real = ti.f32 if features.precision == "f32" else ti.f64
    block = real if features.processor.gpu else ti.types.vector(features.lanes, real)
    node = ti.types.vector(NODE, real)
    elements = {
        "block": block,
        "lane": real,
        "node": node,
        "real": real,
        "i32": ti.i32,
        "i64": ti.i64,
        "f32": ti.f32,
        "f64": ti.f64,
    }
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
    types = {name: ti.types.ndarray(elements[kind.value[0]], kind.value[1]) for name, kind in arrays.items()}
    run.__annotations__ = types | {"first": ti.i32, "last": ti.i32, "phase": ti.template()}
    compiled: Callable[..., None] = ti.kernel(run)
    return compiled
