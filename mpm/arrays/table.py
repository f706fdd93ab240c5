"""The arrays that kernels take, each named here once: batch, kernels and adjoint have theirs from this table."""

import linecache
from collections.abc import Callable, Mapping
from enum import Enum, auto
from typing import Any

import taichi as ti

from mpm.arrays.features import Features


class Kind(Enum):
    """Element and rank of an array; `real` is the precision of the solver."""

    BLOCKS = auto()
    """Vectors of lanes, one after the other."""
    LANES = auto()
    """The numbers of such vectors: a second view of the memory of BLOCKS."""
    NODES = auto()
    """Short vectors of `Features.node` numbers."""
    REAL = auto()
    REAL_TABLE = auto()
    INTEGER = auto()
    INTEGER_TABLE = auto()
    SINGLE = auto()
    DOUBLE = auto()
    DOUBLE_TABLE = auto()


STEP = {
    "state": Kind.BLOCKS,
    "lanes": Kind.LANES,
    "grid": Kind.NODES,
    "scratch": Kind.BLOCKS,
    "scratch_lanes": Kind.LANES,
    "impulse": Kind.BLOCKS,
    "impulse_lanes": Kind.LANES,
    "settings": Kind.REAL_TABLE,
    "properties": Kind.REAL_TABLE,
    "faces": Kind.REAL_TABLE,
    "cell_faces": Kind.INTEGER,
    "near_faces": Kind.INTEGER,
    "cell_distance": Kind.REAL,
    "node_holds": Kind.INTEGER,
    "holds": Kind.REAL_TABLE,
    "offsets": Kind.INTEGER_TABLE,
    "workers": Kind.INTEGER_TABLE,
    "arrivals": Kind.INTEGER,
    "barriers": Kind.INTEGER_TABLE,
    "retained": Kind.INTEGER_TABLE,
    "settling": Kind.DOUBLE_TABLE,
}
"""What a step reads and writes, forwards and in its adjoint; attributes of `mpm.arrays.batch.Batch`."""
RECORD = {"order": Kind.INTEGER, "positions": Kind.SINGLE, "energy": Kind.DOUBLE, "recorded_impulse": Kind.DOUBLE_TABLE}
"""What the end of a frame reads and writes besides."""
DEVICE = {"owner": Kind.INTEGER, "step_control": Kind.REAL_TABLE}
"""What only a GPU reads and writes."""
ADJOINT = {
    "kept": Kind.NODES,
    "grid_adjoints": Kind.NODES,
    "adjoints": Kind.BLOCKS,
    "adjoint_lanes": Kind.LANES,
    "history": Kind.BLOCKS,
    "history_lanes": Kind.LANES,
    "face_adjoints": Kind.DOUBLE_TABLE,
    "hold_adjoints": Kind.DOUBLE_TABLE,
    "impulse_adjoints": Kind.REAL,
    "cuts": Kind.REAL_TABLE,
    "sums": Kind.DOUBLE_TABLE,
    "step_times": Kind.REAL_TABLE,
    "step_counts": Kind.INTEGER,
}
"""What the adjoint reads and writes besides `STEP`; `mpm.adjoint.tape` makes them."""
VIEWS = {
    "lanes": "state",
    "scratch_lanes": "scratch",
    "impulse_lanes": "impulse",
    "adjoint_lanes": "adjoints",
    "history_lanes": "history",
}
"""The arrays of LANES: of whose memory each is a view."""


@ti.data_oriented
class Arrays:
    """The arrays of a kernel by name, as its functions pass them on, with what it was compiled for."""

    def __init__(self, **named: Any) -> None:
        vars(self).update(named)


def arguments(arrays: Mapping[str, Kind], memory: Mapping[str, Any], lanes: int) -> dict[str, Any]:
    """The arrays of a table in its order and in the shape that a kernel takes, from NumPy arrays by name."""
    flat = {Kind.LANES, Kind.REAL, Kind.INTEGER, Kind.SINGLE, Kind.DOUBLE}
    found = {}
    for name, kind in arrays.items():
        array = memory[VIEWS.get(name, name)]
        found[name] = array.reshape(-1, lanes) if kind is Kind.BLOCKS else array.reshape(-1) if kind in flat else array
    return found


def kernel_of(
    arrays: Mapping[str, Kind], body: Callable[..., None], features: Features, **constants: Any
) -> Callable[..., None]:
    """A kernel with the parameters `arrays`, `first`, `last` and `phase`, which it hands to the Taichi function `body`.

    body: of an `Arrays` that holds `features` and `constants` too, `first`, `last` and `phase`. Taichi reads the
    parameters of a kernel in its source, which is written here.
    """
    real = ti.f32 if features.precision == "f32" else ti.f64
    block = real if features.gpu else ti.types.vector(features.lanes, real)
    elements = {
        Kind.BLOCKS: (block, 1),
        Kind.LANES: (real, 1),
        Kind.NODES: (ti.types.vector(features.node, real), 1),
        Kind.REAL: (real, 1),
        Kind.REAL_TABLE: (real, 2),
        Kind.INTEGER: (ti.i32, 1),
        Kind.INTEGER_TABLE: (ti.i32, 2),
        Kind.SINGLE: (ti.f32, 1),
        Kind.DOUBLE: (ti.f64, 1),
        Kind.DOUBLE_TABLE: (ti.f64, 2),
    }
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
    types = {name: ti.types.ndarray(*elements[kind]) for name, kind in arrays.items()}
    run.__annotations__ = types | {"first": ti.i32, "last": ti.i32, "phase": ti.template()}
    compiled: Callable[..., None] = ti.kernel(run)
    return compiled
