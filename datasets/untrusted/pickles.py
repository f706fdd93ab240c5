"""Arrays out of a pickle that somebody else wrote, without executing it.

`numpy.load` reads object arrays by unpickling, which calls whatever the file names. `ArrayUnpickler` is the standard
library's unpickler with three locks, so that arrays, numbers, tuples and lists are all it can make:

- opcodes: `OPCODES`, those of protocol 2 to 4 that numpy's arrays need; any other is refused before it does anything.
- names: five (`find_class`), each of which stands for a function below; nothing is imported.
- states: an array takes (version, shape, dtype, order, bytes or list) where these match; nothing else has one.

No name reaches numpy's own `_reconstruct`, `scalar` or the state of a dtype. The pure-Python unpickler is used on
purpose: the C one allocates its memo by an index that the file states.
"""

import math
import pickle
import pickletools
from typing import IO, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

MOST_READS = 500_000
"""Pieces of a pickle, opcodes and their arguments; an honest trajectory has about two hundred."""
MOST_DIMENSIONS = 8
NUMBERS = frozenset(("b1", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f2", "f4", "f8"))
"""The dtypes that an array may have, without their byte order."""
OPCODES = {
    *("PROTO", "FRAME", "STOP", "MARK", "GLOBAL", "STACK_GLOBAL", "REDUCE", "BUILD"),
    *("MEMOIZE", "BINPUT", "LONG_BINPUT", "BINGET", "LONG_BINGET", "NONE", "NEWTRUE", "NEWFALSE"),
    *("BININT", "BININT1", "BININT2", "LONG1", "LONG4", "BINFLOAT", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8"),
    *("BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "EMPTY_TUPLE", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3"),
    *("EMPTY_LIST", "APPEND", "APPENDS"),
}


class Refused(ValueError):
    """The file holds something that is no array."""


class Dtype:
    """A dtype between its name and its byte order."""

    def __init__(self, code: Any = None, align: Any = None, copy: Any = None) -> None:
        if not (isinstance(code, str) and code in NUMBERS | {"O", "O8"} and align in (0, 1) and copy in (0, 1)):
            raise Refused("found a dtype that is not of plain numbers")
        self.code, self.order = code, "="

    def dtype(self) -> np.dtype[Any]:
        """The dtype that it stands for."""
        return np.dtype(self.order + self.code)


class _Counted:
    """A stream of which only so many pieces are read."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream, self._left = stream, MOST_READS

    def read(self, size: int) -> bytes:
        self._left -= 1
        if self._left < 0:
            raise Refused(f"expected at most {MOST_READS} pieces, found more")
        return self._stream.read(size)

    def readline(self) -> bytes:
        self._left -= 1
        return self._stream.readline(1000)


class ArrayUnpickler(pickle._Unpickler):
    """Unpickler of arrays, numbers, tuples and lists alone; anything else is Refused."""

    stack: list[Any]
    metastack: list[Any]
    read: Any

    def __init__(self, stream: IO[bytes], size: int) -> None:
        super().__init__(_Counted(stream))
        self.left = size
        """Elements and bytes that may still be copied: an honest pickle uses each of its bytes once."""
        self.empty: dict[int, NDArray[Any]] = {}
        """Arrays that have no state yet, by their identity."""

    def find_class(self, module: Any, name: Any) -> Any:
        """What one of the five names of an array stands for here."""
        match module, name:
            case "numpy", "dtype":
                return Dtype
            case "numpy", "ndarray":
                return "ndarray"
            case "_codecs", "encode":
                return self.encode
            case "numpy.core.multiarray" | "numpy._core.multiarray", "_reconstruct":
                return self.reconstruct
            case "numpy.core.multiarray" | "numpy._core.multiarray", "scalar":
                return self.scalar
        raise Refused(f"found the name {f'{module}.{name}'[:80]!r}")

    def spend(self, count: int) -> None:
        """Account for a copy. Without it, a short pickle could ask for the same long copy a million times."""
        self.left -= count
        if self.left < 0:
            raise Refused("found more elements than the pickle has bytes")

    def reconstruct(self, kind: Any = None, shape: Any = None, code: Any = None) -> NDArray[Any]:
        """An empty array, to be filled by its state."""
        if (kind, shape, code) != ("ndarray", (0,), b"b"):
            raise Refused("found reconstruct with arguments that make no array of plain numbers")
        array = np.empty(0)
        self.empty[id(array)] = array
        return array

    def scalar(self, kind: Any = None, content: Any = None) -> np.generic:
        """One number, from its bytes."""
        known = isinstance(kind, Dtype) and kind.code in NUMBERS and isinstance(content, bytes)
        if not known or len(content) != kind.dtype().itemsize:
            raise Refused("found scalar with arguments that make no plain number")
        number: np.generic = np.frombuffer(content, kind.dtype())[0]
        return number

    def encode(self, text: Any = None, encoding: Any = None) -> bytes:
        """Bytes as protocol 2 writes them, as Latin-1 text."""
        if not isinstance(text, str) or encoding != "latin1":
            raise Refused("found encode with arguments that make no bytes")
        self.spend(len(text))
        return text.encode("latin-1")

    def call(self) -> None:
        """REDUCE: only what `find_class` gave is called."""
        arguments, function = self.stack.pop(), self.stack[-1]
        if (function is not Dtype and getattr(function, "__self__", None) is not self) or type(arguments) is not tuple:
            raise Refused("found a call of something that is no function")
        self.stack[-1] = function(*arguments)

    def build(self) -> None:
        """BUILD: the byte order of a dtype, the content of an array."""
        state = self.stack.pop()
        match self.stack[-1], state:
            case Dtype() as kind, (int(), "<" | ">" | "|" | "=" as order, None, None, None, int(), int(), int()):
                kind.order = order
            case np.ndarray() as array, (1, tuple(shape), Dtype() as kind, bool() | 0 | 1 as fortran, content):
                if self.empty.pop(id(array), None) is None:
                    raise Refused("found a second state of an array")
                dtype, count = kind.dtype(), checked_count(shape)
                if dtype.hasobject:
                    if type(content) is not list or len(content) != count:
                        raise Refused("found an object array whose shape does not match its list")
                    self.spend(count)
                elif type(content) is not bytes or len(content) != count * dtype.itemsize:
                    raise Refused("found an array whose shape does not match its bytes")
                else:
                    self.spend(len(content))
                array.__setstate__((1, shape, dtype, bool(fortran), content))  # type: ignore[arg-type]
            case _:
                raise Refused("found the state of something that is no plain array")

    def frame(self) -> None:
        """FRAME: how much could be read ahead, which nothing depends on."""
        self.read(8)

    def refuse(self, opcode: str) -> None:
        """Any other opcode."""
        raise Refused(f"found the opcode {opcode}")

    dispatch: ClassVar[dict[int, Any]] = {
        ord(opcode.code): pickle._Unpickler.dispatch[ord(opcode.code)]
        if opcode.name in OPCODES
        else lambda self, name=opcode.name: self.refuse(name)
        for opcode in pickletools.opcodes
    } | {pickle.REDUCE[0]: call, pickle.BUILD[0]: build, pickle.FRAME[0]: frame}


def read_pickle(stream: IO[bytes], size: int) -> Any:
    """What the pickle of `size` bytes in `stream` holds: numpy arrays and numbers, in tuples, lists and object arrays.

    Raises Refused for anything else, naming the opcode or the name; ValueError for a broken pickle.
    """
    try:
        unpickler = ArrayUnpickler(stream, size)
        value = unpickler.load()
    except Refused:
        raise
    except KeyError as error:
        raise ValueError(f"expected a whole pickle, found no opcode or value {error}") from None
    except (pickle.UnpicklingError, EOFError, IndexError, AttributeError, TypeError, AssertionError) as error:
        raise ValueError(f"expected a whole pickle, {error}") from None
    if unpickler.stack or unpickler.metastack:
        raise Refused("found more than one value")
    if unpickler.empty:
        raise Refused("found an array before it is complete")
    check_plain(value)
    return value


def checked_count(shape: tuple[Any, ...]) -> int:
    """Elements of an array of `shape`. Raises Refused for what is no shape."""
    if len(shape) > MOST_DIMENSIONS or not all(type(length) is int and 0 <= length < 2**48 for length in shape):
        raise Refused("found an array with a shape that is none")
    return math.prod(shape)


def check_plain(value: Any) -> None:
    """Raise Refused unless `value` is made of arrays and numbers alone; each container is visited once."""
    visited: set[int] = set()
    waiting = [value]
    while waiting:
        each = waiting.pop()
        if isinstance(each, tuple | list) or (isinstance(each, np.ndarray) and each.dtype.hasobject):
            if id(each) not in visited:
                visited.add(id(each))
                waiting.extend(each.flat if isinstance(each, np.ndarray) else each)
        elif not isinstance(each, np.ndarray | np.generic | int | float):
            raise Refused(f"found a {type(each).__name__}, which is neither an array nor a number")
