"""Functions on vectors that Taichi cannot express, in LLVM assembly; kernels call them.

Taichi 1.7.4 multiplies and adds vectors in two instructions where a processor has one, looks up the address of an array
at every access, and takes a vector apart number by number. Therefore the inner loops of the two transfers, most of a
step, are these functions, for any processor that LLVM supports. `vectors.bc` holds them as LLVM bitcode, which Taichi
links into a kernel; after a change here, rebuild it with `python -m mpm.arrays.bitcode` and `llvm-as` 14 or 15.

A node is a vector of NODE numbers; a pair is two nodes side by side. Addresses are integers, which the compiler knows
to be constant. Within a function each variable is assigned once, as LLVM requires.
"""

import subprocess
import sys
import zlib
from collections.abc import Callable, Iterable, Sequence
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import Any

from mpm.arrays.features import NODE, REGISTER

FILE = Path(__file__).with_name("vectors.bc")
LAYOUT = "e-m:e-p270:32:32-p271:32:32-p272:64:64-i64:64-f80:128-n8:16:32:64-S128"  # of x86-64: LLVM does not warn
SIZES = {"f32": ("float", 4), "f64": ("double", 8)}  # by precision: LLVM's name of a number, and its bytes
PAIR, ROW = 2 * NODE, 4 * NODE  # numbers of a pair, and of a row of `to_rows`: four nodes
WIDE, BLOCK = 64, 16  # bytes of the widest vector register, and of the blocks within which single numbers move
REAL, ADDRESS = 1, 0  # kinds of parameters: a number, an address; for a vector its length


@cache
def call(name: str, precision: str) -> Callable[..., None]:
    """A function of this file for use in Taichi functions; it takes local variables and may change the first."""

    def linked(*values: Any) -> None:
        # Imported here: --help needs no compiler.
        from taichi._lib import core
        from taichi.lang import impl
        from taichi.lang.expr import make_expr_group

        runtime, symbol = impl.get_runtime(), f"{name}_{precision}_{version()}"
        given, place = make_expr_group(values), core.DebugInfo(runtime.get_current_src_info())
        insert = runtime.compiling_callable.ast_builder().insert_external_func_call
        insert(0, "", str(FILE), symbol, given, make_expr_group([]), place)

    # Otherwise Taichi warns about calls of unknown functions.
    linked._is_wrapped_kernel = True  # type: ignore[attr-defined]
    return linked


class Function:
    """One function as lines of LLVM's assembly."""

    def __init__(self, name: str, precision: str, **parameters: int) -> None:
        self.precision, self.lines, self.count = precision, list[str](), 0
        self.real, self.bytes = SIZES[precision]
        self.kinds = {key: self.kind(length) for key, length in parameters.items()}
        given = ", ".join(f"{kind}* %{key}" for key, kind in self.kinds.items())
        self.head = f"define void @{name}_{precision}_VERSION({given}) alwaysinline {{"

    def kind(self, length: int) -> str:
        """LLVM's name of an address, a number or a vector of this length."""
        return {ADDRESS: "i64", REAL: self.real}.get(length) or f"<{length} x {self.real}>"

    def add(self, instruction: str) -> str:
        """Append an instruction; return the variable with its result."""
        self.count += 1
        self.lines.append(f"  %v{self.count} = {instruction}")
        return f"%v{self.count}"

    def read(self, key: str) -> str:
        """The value of a parameter."""
        return self.add(f"load {self.kinds[key]}, {self.kinds[key]}* %{key}")

    def write(self, key: str, value: str) -> None:
        """Set a parameter."""
        self.lines.append(f"  store {self.kinds[key]} {value}, {self.kinds[key]}* %{key}")

    def place(self, address: str, first: int, length: int) -> str:
        """A pointer to the vector that begins at the number `first` behind an address."""
        at = self.add(f"add i64 {address}, {first * self.bytes}")
        return self.add(f"inttoptr i64 {at} to {self.kind(length)}*")

    def load(self, place: str, length: int) -> str:
        """Load the vector at a pointer."""
        kind = self.kind(length)
        return self.add(f"load {kind}, {kind}* {place}, align {min(length * self.bytes, WIDE)}")

    def store(self, place: str, value: str, length: int) -> None:
        """Store a vector at a pointer."""
        kind = self.kind(length)
        self.lines.append(f"  store {kind} {value}, {kind}* {place}, align {min(length * self.bytes, WIDE)}")

    def choose(self, a: str, b: str, length: int, numbers: Iterable[int]) -> str:
        """A vector of chosen numbers of two vectors, numbered through from the first to the second."""
        kind, chosen = self.kind(length), [f"i32 {n}" for n in numbers]
        mask = f"<{len(chosen)} x i32> <{', '.join(chosen)}>"
        return self.add(f"shufflevector {kind} {a}, {kind} {b}, {mask}")

    def spread(self, keys: Sequence[str], length: int) -> str:
        """A vector of equal parts, each with one parameter everywhere."""
        kind, vector = self.kind(length), "undef"
        for n, key in enumerate(keys):
            vector = self.add(f"insertelement {kind} {vector}, {self.real} {self.read(key)}, i32 {n}")
        return self.choose(vector, vector, length, [n * len(keys) // length for n in range(length)])

    def fused(self, a: str, b: str, c: str, length: int) -> str:
        """a b + c."""
        kind = self.kind(length)
        return self.add(f"call {kind} @llvm.fmuladd.v{length}{self.precision}({kind} {a}, {kind} {b}, {kind} {c})")

    def text(self) -> str:
        """The whole function."""
        return "\n".join([self.head, *self.lines, "  ret void", "}"])


def add_scaled(precision: str, name: str = "add_scaled", length: int = NODE) -> Function:
    """total += scale value."""
    f = Function(name, precision, total=length, scale=REAL, value=length)
    f.write("total", f.fused(f.spread(["scale"], length), f.read("value"), f.read("total"), length))
    return f


def add_first_scaled(precision: str) -> Function:
    """total += scale times the first node of a pair."""
    f = Function("add_first_scaled", precision, total=NODE, scale=REAL, pair=PAIR)
    pair = f.read("pair")
    first = f.choose(pair, pair, PAIR, range(NODE))
    f.write("total", f.fused(f.spread(["scale"], NODE), first, f.read("total"), NODE))
    return f


def pair_of(precision: str) -> Function:
    """A pair whose first node is one number everywhere, its second another."""
    f = Function("pair_of", precision, pair=PAIR, one=REAL, other=REAL)
    f.write("pair", f.spread(["one", "other"], PAIR))
    return f


def split(precision: str) -> Function:
    """The two nodes of a pair."""
    f = Function("split", precision, first=NODE, second=NODE, pair=PAIR)
    pair = f.read("pair")
    for n, key in enumerate(("first", "second")):
        f.write(key, f.choose(pair, pair, PAIR, range(n * NODE, (n + 1) * NODE)))
    return f


def add_to_column(precision: str) -> Function:
    """Three nodes from an address on += a weight of each times a value that rises by `step` from node to node."""
    weights = {f"w{n}": REAL for n in range(3)}
    f = Function("add_to_column", precision, address=ADDRESS, value=NODE, step=NODE, **weights)
    address, value, step = f.read("address"), f.read("value"), f.read("step")
    for n in range(3):
        if n:
            value = f.add(f"fadd {f.kind(NODE)} {value}, {step}")
        place = f.place(address, n * NODE, NODE)
        f.store(place, f.fused(f.spread([f"w{n}"], NODE), value, f.load(place, NODE), NODE), NODE)
    return f


def column_sums(precision: str) -> Function:
    """The sum of three nodes from an address on, each duplicated to a pair, times a pair of weights."""
    weights = {f"s{n}": PAIR for n in range(3)}
    f = Function("column_sums", precision, total=PAIR, address=ADDRESS, **weights)
    address, total = f.read("address"), ""
    for n, key in enumerate(weights):
        node = f.load(f.place(address, n * NODE, NODE), NODE)
        twice, scale = f.choose(node, node, NODE, [*range(NODE), *range(NODE)]), f.read(key)
        total = f.fused(scale, twice, total, PAIR) if n else f.add(f"fmul {f.kind(PAIR)} {scale}, {twice}")
    f.write("total", total)
    return f


def read_ahead(precision: str) -> Function:
    """Prefetch the cache line of an address, without waiting for it."""
    f = Function("read_ahead", precision, address=ADDRESS)
    place = f.add(f"inttoptr i64 {f.read('address')} to i8*")
    f.lines.append(f"  call void @llvm.prefetch.p0i8(i8* {place}, i32 0, i32 3, i32 1)")
    return f


def to_rows(precision: str, name: str = "to_rows") -> Function:
    """From ROW vectors of lanes at `source` make a row of ROW numbers of each lane at `target`, or the reverse: square
    by square of vectors as wide as a processor's."""
    f = Function(name, precision, source=ADDRESS, target=ADDRESS)
    lanes, width = REGISTER // f.bytes, WIDE // f.bytes
    source, target = f.read("source"), f.read("target")
    for lane, number in product(range(0, lanes, width), range(0, ROW, width)):
        in_lanes = [(number + k) * lanes + lane for k in range(width)]
        in_rows = [(lane + k) * ROW + number for k in range(width)]
        places = (in_lanes, in_rows) if name == "to_rows" else (in_rows, in_lanes)
        square = [f.load(f.place(source, at, width), width) for at in places[0]]
        for at, vector in zip(places[1], transposed(f, square), strict=True):
            f.store(f.place(target, at, width), vector, width)
    return f


def transposed(f: Function, rows: list[str]) -> list[str]:
    """The columns of a square of vectors: each move is one instruction, within blocks first, then of blocks."""
    width, inner = len(rows), BLOCK // f.bytes
    for first in range(0, width, inner):
        part, span = rows[first : first + inner], 1
        while span < inner:
            pairs = [interleaved(f, part[2 * n], part[2 * n + 1], span, width) for n in range(inner // 2)]
            part, span = [pair[half] for half in range(2) for pair in pairs], 2 * span
        # After two such moves the inner two stand the wrong way round.
        part[1 : inner - 1] = part[inner - 2 : 0 : -1]
        rows[first : first + inner] = part
    for span in (inner, 2 * inner):
        for row in (r for r in range(width) if not r & span):
            a, b = rows[row], rows[row + span]
            rows[row] = f.choose(a, b, width, [n + width - span if n & span else n for n in range(width)])
            rows[row + span] = f.choose(a, b, width, [n + width if n & span else n + span for n in range(width)])
    return rows


def interleaved(f: Function, a: str, b: str, span: int, width: int) -> list[str]:
    """Interleave two vectors, `span` numbers in turn: the first halves of their blocks, and the second halves."""
    inner, vectors = BLOCK // f.bytes, []
    for half in range(2):
        chunks = range(half * inner // 2, (half + 1) * inner // 2, span)
        starts = [block + chunk + other for block in range(0, width, inner) for chunk in chunks for other in (0, width)]
        vectors.append(f.choose(a, b, width, [start + n for start in starts for n in range(span)]))
    return vectors


FUNCTIONS: list[Callable[[str], Function]] = [add_scaled, partial(add_scaled, name="add_scaled_pair", length=PAIR)]
FUNCTIONS += [add_first_scaled, pair_of, split, add_to_column, column_sums, read_ahead, to_rows]
FUNCTIONS += [partial(to_rows, name="to_lanes")]


@cache
def template() -> str:
    """All functions as LLVM's assembly, with VERSION in their names."""
    lines = [f'target datalayout = "{LAYOUT}"', "declare void @llvm.prefetch.p0i8(i8*, i32, i32, i32)"]
    for precision, length in product(SIZES, (NODE, PAIR)):
        kind = Function("", precision).kind(length)
        lines.append(f"declare {kind} @llvm.fmuladd.v{length}{precision}({kind}, {kind}, {kind})")
    return "\n".join([*lines, *(make(precision).text() for precision in SIZES for make in FUNCTIONS)])


@cache
def version() -> str:
    """The suffix of the functions' names: Taichi caches kernels by these, not by the content of the file."""
    return f"{zlib.crc32(template().encode()):08x}"


if __name__ == "__main__":
    text = template().replace("VERSION", version()) + "\n"
    subprocess.run([sys.argv[1] if sys.argv[1:] else "llvm-as", "-o", str(FILE)], input=text, text=True, check=True)
