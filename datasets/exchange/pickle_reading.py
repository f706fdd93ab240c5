"""Arrays out of a pickle that is never executed: its opcodes are read one by one, and arrays are all they can make.

A pickle is a program for a small stack machine; unpickling runs it, and it may call whatever it names. Here the
standard library only takes the program apart (`pickletools.genops`). What follows is a machine of our own that knows
the opcodes a numpy array needs and the names below. It imports nothing and calls nothing by name: an array is
`numpy.frombuffer` of bytes that stand in the file.

| name in the pickle | what it stands for here |
|---|---|
| `numpy.core.multiarray._reconstruct`, `numpy._core...` | an array, to be filled by its state |
| `numpy.core.multiarray.scalar`, `numpy._core...` | one number of a dtype |
| `numpy.ndarray`, `numpy.dtype` | the class of an array; a dtype, to be completed by its state |
| `_codecs.encode` | bytes as protocol 2 writes them, as Latin-1 text |
"""

import math
import pickletools
from dataclasses import dataclass
from enum import Enum, auto
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

MOST_OPCODES = 2_000_000
"""An honest trajectory takes about sixty."""
MOST_DIMENSIONS = 8

NUMBERS = frozenset(("b1", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f2", "f4", "f8"))
"""The dtypes that an array may have, without their byte order."""
OBJECTS = frozenset(("O", "O8"))
"""The dtype of an array of arrays."""

VALUES = frozenset(
    {
        *("BININT", "BININT1", "BININT2", "LONG1", "LONG4", "BINFLOAT"),
        *("BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8", "BINBYTES", "SHORT_BINBYTES", "BINBYTES8"),
    }
)
"""Opcodes that push the value they carry."""
CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False, "EMPTY_TUPLE": ()}
TUPLES = {"TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}


class Refused(ValueError):
    """The pickle holds something that is no array."""


class Name(Enum):
    """What a name that a pickle may use stands for."""

    RECONSTRUCT = auto()
    SCALAR = auto()
    NDARRAY = auto()
    DTYPE = auto()
    ENCODE = auto()


ADMITTED = {
    ("numpy.core.multiarray", "_reconstruct"): Name.RECONSTRUCT,
    ("numpy._core.multiarray", "_reconstruct"): Name.RECONSTRUCT,
    ("numpy.core.multiarray", "scalar"): Name.SCALAR,
    ("numpy._core.multiarray", "scalar"): Name.SCALAR,
    ("numpy", "ndarray"): Name.NDARRAY,
    ("numpy", "dtype"): Name.DTYPE,
    ("_codecs", "encode"): Name.ENCODE,
}

MARK = object()


@dataclass(eq=False)
class Unfinished:
    """An array or a dtype between its making and its state; `value` once it has it."""

    kind: Name
    code: str = ""
    """Of a dtype: what it was made from, such as `f4`."""
    value: Any = None


def read_pickle(stream: IO[bytes], size: int) -> Any:
    """What the pickle of `size` bytes in `stream` holds: numpy arrays and numbers, in tuples, lists and object arrays.

    Raises Refused, which names the opcode or the name that is not admitted; ValueError for a broken pickle.
    """
    machine = _Machine(size)
    for count, (opcode, argument, _) in enumerate(pickletools.genops(stream)):
        if count == MOST_OPCODES:
            raise Refused(f"expected at most {MOST_OPCODES} opcodes, found more")
        if opcode.name != "STOP":
            machine.step(opcode.name, argument)
    return machine.result()


class _Machine:
    """The stack, the memo and what each opcode does to them."""

    def __init__(self, size: int) -> None:
        self.stack: list[Any] = []
        self.memo: dict[int, Any] = {}
        self.left = size
        """Elements and bytes that may still be copied: an honest pickle uses each of its bytes once."""

    def step(self, opcode: str, argument: Any) -> None:
        """Do what one opcode says. Raises Refused."""
        push = self.stack.append
        if opcode in VALUES:
            push(argument)
        elif opcode in CONSTANTS:
            push(CONSTANTS[opcode])
        elif opcode in TUPLES:
            push(tuple(reversed([self.pop() for _ in range(TUPLES[opcode])])))
        elif opcode == "TUPLE":
            push(tuple(self.pop_to_mark()))
        elif opcode == "MARK":
            push(MARK)
        elif opcode == "EMPTY_LIST":
            push([])
        elif opcode in ("APPEND", "APPENDS"):
            items = [self.pop()] if opcode == "APPEND" else self.pop_to_mark()
            self.top(list, opcode).extend(items)
        elif opcode in ("MEMOIZE", "BINPUT", "LONG_BINPUT"):
            self.memo[len(self.memo) if opcode == "MEMOIZE" else argument] = self.top(object, opcode)
        elif opcode in ("BINGET", "LONG_BINGET"):
            if argument not in self.memo:
                raise Refused(f"expected a value that was kept before, found {opcode} of another")
            push(self.memo[argument])
        elif opcode == "GLOBAL":
            push(admitted(*argument.partition(" ")[::2]))
        elif opcode == "STACK_GLOBAL":
            name, module = self.pop(), self.pop()
            push(admitted(module, name))
        elif opcode == "REDUCE":
            arguments, name = self.pop(), self.pop()
            push(self.make(name, arguments))
        elif opcode == "BUILD":
            state = self.pop()
            self.finish(self.top(Unfinished, opcode), state)
        elif not (opcode == "FRAME" or (opcode == "PROTO" and 2 <= argument <= 5)):
            raise Refused(f"found the opcode {opcode}")

    def pop(self) -> Any:
        """The value on top of the stack."""
        if not self.stack or self.stack[-1] is MARK:
            raise Refused("expected a value, found an empty stack")
        value = self.stack.pop()
        if isinstance(value, Unfinished):
            if value.value is None:
                raise Refused("found an array or a dtype that is used before it is complete")
            return value.value
        return value

    def pop_to_mark(self) -> list[Any]:
        """The values above the last mark, which goes too."""
        values = []
        while self.stack and self.stack[-1] is not MARK:
            values.append(self.pop())
        if not self.stack:
            raise Refused("expected a mark, found an empty stack")
        self.stack.pop()
        return values[::-1]

    def top(self, kind: type, opcode: str) -> Any:
        """What lies on top of the stack, left there."""
        if not self.stack or self.stack[-1] is MARK or not isinstance(self.stack[-1], kind):
            raise Refused(f"found {opcode} of a value that it does not go with")
        return self.stack[-1]

    def spend(self, count: int) -> None:
        """Account for a copy. Without it, a short pickle could ask for the same long copy a million times."""
        self.left -= count
        if self.left < 0:
            raise Refused("found more elements than the pickle has bytes")

    def make(self, name: Any, arguments: Any) -> Any:
        """What `name(*arguments)` would be."""
        match name, arguments:
            case Name.RECONSTRUCT, (Name.NDARRAY, (0,), bytes()):
                return Unfinished(Name.NDARRAY)
            case Name.DTYPE, (str(code), bool() | 0 | 1, bool() | 0 | 1) if code in NUMBERS | OBJECTS:
                return Unfinished(Name.DTYPE, code)
            case Name.SCALAR, (np.dtype() as dtype, bytes(data)) if not dtype.hasobject and len(data) == dtype.itemsize:
                return np.frombuffer(data, dtype)[0]
            case Name.ENCODE, (str(text), "latin1"):
                self.spend(len(text))
                return text.encode("latin-1")
            case Name(), _:
                raise Refused(f"found {name.name.lower()} with arguments that make no array of plain numbers")
        raise Refused("found a call of something that is no function")

    def finish(self, target: Unfinished, state: Any) -> None:
        """Give an array or a dtype its state."""
        if target.value is not None:
            raise Refused("found a second state of an array or a dtype")
        match target.kind, state:
            case Name.DTYPE, (int(), "<" | ">" | "|" | "=" as order, None, None, None, int(), int(), int()):
                target.value = np.dtype(order.replace("|", "") + target.code)
            case Name.NDARRAY, (1, tuple(shape), np.dtype() as dtype, bool() | 0 | 1 as fortran, content):
                target.value = self.array(shape, dtype, content, "F" if fortran else "C")
            case _:
                raise Refused(f"found the state of no plain {target.kind.name.lower()}")

    def array(self, shape: tuple[Any, ...], dtype: np.dtype[Any], content: Any, order: Any) -> NDArray[Any]:
        """An array of numbers from its bytes or, of objects, from a list."""
        if dtype.hasobject:
            count = checked_count(shape)
            if not isinstance(content, list) or len(content) != count:
                raise Refused("found an object array whose shape does not match its list")
            self.spend(count)
            objects = np.empty(count, dtype=object)
            for place, value in enumerate(content):
                objects[place] = value
            return objects.reshape(shape, order=order)
        if not isinstance(content, bytes):
            raise Refused("found an array of numbers without bytes")
        return numbers(content, shape, dtype, order)

    def result(self) -> Any:
        """What is left when the program ends: one value of arrays and numbers."""
        value = self.pop()
        if self.stack:
            raise Refused("found more than one value")
        check_plain(value)
        return value


def admitted(module: Any, name: Any) -> Name:
    """What a name stands for. Raises Refused for any other than the few of an array."""
    if not (isinstance(module, str) and isinstance(name, str) and (module, name) in ADMITTED):
        raise Refused(f"found the name {f'{module}.{name}'[:80]!r}")
    return ADMITTED[module, name]


def numbers(content: bytes, shape: tuple[Any, ...], dtype: np.dtype[Any], order: Any) -> NDArray[Any]:
    """The array that `content` is, read-only and without a copy. Raises Refused where shape and bytes do not match."""
    if checked_count(shape) * dtype.itemsize != len(content):
        raise Refused("found an array whose shape does not match its bytes")
    if not content:
        return np.empty(shape, dtype)
    return np.frombuffer(content, dtype).reshape(shape, order=order)


def checked_count(shape: tuple[Any, ...]) -> int:
    """Elements of an array of `shape`. Raises Refused for what is no shape."""
    plain = all(type(length) is int and 0 <= length < 2**48 for length in shape)
    if len(shape) > MOST_DIMENSIONS or not plain:
        raise Refused("found an array with a shape that is none")
    return math.prod(shape)


def check_plain(value: Any) -> None:
    """Raise Refused unless `value` is made of arrays and numbers alone, each container looked at once."""
    seen: set[int] = set()
    waiting = [value]
    while waiting:
        each = waiting.pop()
        if isinstance(each, tuple | list) or (isinstance(each, np.ndarray) and each.dtype.hasobject):
            if id(each) not in seen:
                seen.add(id(each))
                waiting.extend(each.flat if isinstance(each, np.ndarray) else each)
        elif not isinstance(each, np.ndarray | np.generic | int | float):
            raise Refused(f"found a {type(each).__name__}, which is neither an array nor a number")
