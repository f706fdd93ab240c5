"""Functions on vectors that Taichi cannot write and LLVM has: written here as LLVM's assembly, called from kernels.

Taichi 1.7.4 multiplies and adds vectors in two instructions where a processor has one, looks up an array's address anew
at every access, and takes a vector apart number by number. The inner loops of the two transfers, which are most of a
step, are therefore these functions, on any processor that LLVM compiles for. `vectors.bc` is this text as LLVM's bitcode,
which Taichi links into a kernel: after a change here, `python -m mpm.arrays.bitcode` makes it, with `llvm-as` 14 or 15.

A node is a vector of NODE numbers, a pair two nodes side by side. An address is an integer: the compiler then knows that
it stays as it is.
"""

import subprocess
import sys
from collections.abc import Callable, Iterable
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

from mpm.arrays.features import NODE, REGISTER

FILE = Path(__file__).with_name("vectors.bc")
SIZES = {"f32": ("float", 4), "f64": ("double", 8)}
"""By precision: LLVM's name of a number, and its bytes."""
LAYOUT = "e-m:e-p270:32:32-p271:32:32-p272:64:64-i64:64-f80:128-n8:16:32:64-S128"
"""Of data in Taichi's kernels on x86-64, so that LLVM has nothing to warn of."""
ROW = 4 * NODE
"""Numbers of a row of `to_rows`: four nodes."""
WIDE, BLOCK = 64, 16
"""Bytes of the widest vector of a processor, and of the part within which it moves single numbers."""


@cache
def call(name: str, precision: str) -> Callable[..., None]:
    """A function of this file for use in Taichi's functions; its arguments are local variables, which it may change."""

    def linked(*values: Any) -> None:
        # Imported here: who asks for help needs no compiler.
        from taichi._lib import core
        from taichi.lang import impl
        from taichi.lang.expr import make_expr_group

        runtime = impl.get_runtime()
        place = core.DebugInfo(runtime.get_current_src_info())
        builder = runtime.compiling_callable.ast_builder()
        builder.insert_external_func_call(0, "", str(FILE), f"{name}_{precision}", make_expr_group(values), make_expr_group([]), place)

    # Taichi warns of calls of what it does not know.
    linked._is_wrapped_kernel = True  # type: ignore[attr-defined]
    return linked


def mask(numbers: Iterable[int]) -> str:
    """A choice of elements of two vectors, those of the second counted on from those of the first."""
    chosen = [f"i32 {n}" for n in numbers]
    return f"<{len(chosen)} x i32> <{', '.join(chosen)}>"


class Function:
    """One function of the file: lines of LLVM's assembly with its variables."""

    def __init__(self, name: str, precision: str, **parameters: str) -> None:
        self.real, self.bytes = SIZES[precision]
        self.precision, self.count = precision, 0
        types = {key: self.type_of(kind) for key, kind in parameters.items()}
        given = ", ".join(f"{kind}* %{key}" for key, kind in types.items())
        self.lines = [f"define void @{name}_{precision}({given}) alwaysinline {{"]
        self.types = types

    def type_of(self, kind: str) -> str:
        """LLVM's name of a kind: "real", "i64", or the length of a vector."""
        return {"real": self.real, "i64": "i64"}.get(kind) or f"<{kind} x {self.real}>"

    def add(self, line: str) -> str:
        """Append an instruction; the variable that holds its result."""
        self.count += 1
        self.lines.append(f"  %v{self.count} = {line}")
        return f"%v{self.count}"

    def read(self, key: str) -> str:
        """The value of a parameter."""
        return self.add(f"load {self.types[key]}, {self.types[key]}* %{key}")

    def write(self, key: str, value: str) -> None:
        """Set a parameter."""
        self.lines.append(f"  store {self.types[key]} {value}, {self.types[key]}* %{key}")

    def everywhere(self, key: str, length: int) -> str:
        """A vector whose elements are all a parameter."""
        kind = self.type_of(str(length))
        first = self.add(f"insertelement {kind} undef, {self.real} {self.read(key)}, i32 0")
        return self.choose(first, first, length, [0] * length)

    def choose(self, a: str, b: str, length: int, numbers: Iterable[int]) -> str:
        """A vector of chosen elements of two."""
        kind = self.type_of(str(length))
        return self.add(f"shufflevector {kind} {a}, {kind} {b}, {mask(numbers)}")

    def fused(self, a: str, b: str, c: str, length: int) -> str:
        """a b + c."""
        kind = self.type_of(str(length))
        return self.add(f"call {kind} @llvm.fmuladd.v{length}{self.precision}({kind} {a}, {kind} {b}, {kind} {c})")

    def place(self, address: str, first: int, length: int) -> str:
        """A pointer to a vector from the `first` number at an address on."""
        at = self.add(f"add i64 {address}, {first * self.bytes}")
        return self.add(f"inttoptr i64 {at} to {self.type_of(str(length))}*")

    def load(self, pointer: str, length: int) -> str:
        """The vector at a pointer."""
        kind = self.type_of(str(length))
        return self.add(f"load {kind}, {kind}* {pointer}, align {min(length * self.bytes, WIDE)}")

    def store(self, pointer: str, value: str, length: int) -> None:
        """Put a vector there."""
        kind = self.type_of(str(length))
        self.lines.append(f"  store {kind} {value}, {kind}* {pointer}, align {min(length * self.bytes, WIDE)}")

    def text(self) -> str:
        """The function as LLVM reads it."""
        return "\n".join([*self.lines, "  ret void", "}"])


def add_scaled(precision: str, length: int) -> str:
    """total += scale value."""
    of = Function("add_scaled" if length == NODE else "add_scaled_pair", precision, total=str(length), scale="real", value=str(length))
    of.write("total", of.fused(of.everywhere("scale", length), of.read("value"), of.read("total"), length))
    return of.text()


def add_first_scaled(precision: str) -> str:
    """total += scale times the first node of a pair."""
    of = Function("add_first_scaled", precision, total=str(NODE), scale="real", pair=str(2 * NODE))
    pair = of.read("pair")
    first = of.choose(pair, pair, 2 * NODE, range(NODE))
    of.write("total", of.fused(of.everywhere("scale", NODE), first, of.read("total"), NODE))
    return of.text()


def scales(precision: str) -> str:
    """A pair of one number everywhere in the first node and another in the second."""
    of = Function("scales", precision, pair=str(2 * NODE), one="real", other="real")
    kind = of.type_of(str(2 * NODE))
    first = of.add(f"insertelement {kind} undef, {of.real} {of.read('one')}, i32 0")
    both = of.add(f"insertelement {kind} {first}, {of.real} {of.read('other')}, i32 1")
    of.write("pair", of.choose(both, both, 2 * NODE, [0] * NODE + [1] * NODE))
    return of.text()


def split(precision: str) -> str:
    """The two nodes of a pair."""
    of = Function("split", precision, first=str(NODE), second=str(NODE), pair=str(2 * NODE))
    pair = of.read("pair")
    of.write("first", of.choose(pair, pair, 2 * NODE, range(NODE)))
    of.write("second", of.choose(pair, pair, 2 * NODE, range(NODE, 2 * NODE)))
    return of.text()


def add_column(precision: str) -> str:
    """Three nodes at an address, one after the other, += a weight of each times a value that rises by `step`."""
    names = {"address": "i64", "value": str(NODE), "step": str(NODE), "w0": "real", "w1": "real", "w2": "real"}
    of = Function("add_column", precision, **names)
    address, value, step = of.read("address"), of.read("value"), of.read("step")
    kind = of.type_of(str(NODE))
    for node in range(3):
        place = of.place(address, node * NODE, NODE)
        of.store(place, of.fused(of.everywhere(f"w{node}", NODE), value, of.load(place, NODE), NODE), NODE)
        if node < 2:
            value = of.add(f"fadd {kind} {value}, {step}")
    return of.text()


def sum_column(precision: str) -> str:
    """Of three nodes at an address the sums by two sets of weights, those of `scales`, as a pair."""
    pair = str(2 * NODE)
    of = Function("sum_column", precision, total=pair, address="i64", s0=pair, s1=pair, s2=pair)
    address, total, kind = of.read("address"), "", of.type_of(pair)
    for node in range(3):
        value = of.load(of.place(address, node * NODE, NODE), NODE)
        twice = of.choose(value, value, NODE, [k % NODE for k in range(2 * NODE)])
        weights = of.read(f"s{node}")
        total = of.fused(weights, twice, total, 2 * NODE) if node else of.add(f"fmul {kind} {weights}, {twice}")
    of.write("total", total)
    return of.text()


def interleaved(of: Function, a: str, b: str, span: int, width: int) -> list[str]:
    """Of two vectors in turn `span` numbers of each: of the first halves of their blocks, and of the second ones."""
    inner, chosen = BLOCK // of.bytes, []
    for half in range(2):
        chunks = range(half * inner // 2, (half + 1) * inner // 2, span)
        starts = [block + chunk + other for block in range(0, width, inner) for chunk in chunks for other in (0, width)]
        chosen.append(of.choose(a, b, width, [start + n for start in starts for n in range(span)]))
    return chosen


def transposed(of: Function, rows: list[str]) -> list[str]:
    """The columns of a square of numbers, WIDE bytes each: turned within blocks, one instruction each, then as blocks."""
    width, inner = len(rows), BLOCK // of.bytes
    for first in range(0, width, inner):
        part = rows[first : first + inner]
        span = 1
        while span < inner:
            half = inner // 2
            pairs = [interleaved(of, part[2 * n], part[2 * n + 1], span, width) for n in range(half)]
            part, span = [pairs[n][side] for side in range(2) for n in range(half)], 2 * span
        # After two such steps the inner two are the wrong way round.
        part[1 : inner - 1] = part[inner - 2 : 0 : -1]
        rows[first : first + inner] = part
    for span in (inner, 2 * inner):
        turned = list(rows)
        for row in (r for r in range(width) if not r & span):
            a, b = rows[row], rows[row + span]
            turned[row] = of.choose(a, b, width, [n + width - span if n & span else n for n in range(width)])
            turned[row + span] = of.choose(a, b, width, [n + width if n & span else n + span for n in range(width)])
        rows = turned
    return rows


def read_ahead(precision: str) -> str:
    """Have a cache line brought, without waiting for it."""
    of = Function("read_ahead", precision, address="i64")
    place = of.add(f"inttoptr i64 {of.read('address')} to i8*")
    of.lines.append(f"  call void @llvm.prefetch.p0i8(i8* {place}, i32 0, i32 3, i32 1)")
    return of.text()


def moved(precision: str, name: str, *, columns_first: bool) -> str:
    """Rows of ROW numbers, one for each lane, from as many vectors of lanes (`to_rows`), or the reverse (`to_lanes`)."""
    of = Function(name, precision, source="i64", target="i64")
    lanes, width = REGISTER // of.bytes, WIDE // of.bytes
    source, target = of.read("source"), of.read("target")
    for lane, number in product(range(0, lanes, width), range(0, ROW, width)):
        by_number = [(number + k) * lanes + lane for k in range(width)]
        by_lane = [(lane + k) * ROW + number for k in range(width)]
        places = (by_number, by_lane) if columns_first else (by_lane, by_number)
        vectors = [of.load(of.place(source, at, width), width) for at in places[0]]
        for at, vector in zip(places[1], transposed(of, vectors), strict=True):
            of.store(of.place(target, at, width), vector, width)
    return of.text()


def assembly() -> str:
    """All functions as LLVM's assembly."""
    declared, functions = ["declare void @llvm.prefetch.p0i8(i8*, i32, i32, i32)"], []
    for precision in SIZES:
        for length in (NODE, 2 * NODE):
            kind = f"<{length} x {SIZES[precision][0]}>"
            declared.append(f"declare {kind} @llvm.fmuladd.v{length}{precision}({kind}, {kind}, {kind})")
            functions.append(add_scaled(precision, length))
        functions += [make(precision) for make in (add_first_scaled, scales, split, add_column, sum_column, read_ahead)]
        functions += [moved(precision, "to_rows", columns_first=True), moved(precision, "to_lanes", columns_first=False)]
    return "\n\n".join([f'target datalayout = "{LAYOUT}"', "\n".join(declared), *functions]) + "\n"


if __name__ == "__main__":
    subprocess.run([sys.argv[1] if sys.argv[1:] else "llvm-as", "-o", str(FILE)], input=assembly(), text=True, check=True)
