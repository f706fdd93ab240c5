"""An array of arrays as a pickle that every numpy reads.

What `numpy.savez` of numpy 2 pickles names `numpy._core`, which numpy before 1.26 does not have; the peers pin 1.23.
Both read the older name, `numpy.core.multiarray`, so the few opcodes of an array are written here by that name; and
straight from the array's memory, without the copies that a pickler makes.
"""

import pickletools
import struct
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

CODE = {opcode.name: opcode.code.encode("latin-1") for opcode in pickletools.opcodes}
Piece = bytes | memoryview


def object_array_pickle(items: Sequence[NDArray[Any]]) -> Iterator[Piece]:
    """The pickle (protocol 4) of a one-dimensional object array that holds `items`, in pieces."""
    yield CODE["PROTO"] + b"\x04"
    yield from _array((len(items),), np.dtype(object), _objects(items))
    yield CODE["STOP"]


def _objects(items: Sequence[NDArray[Any]]) -> Iterator[Piece]:
    yield CODE["EMPTY_LIST"] + CODE["MARK"]
    for item in items:
        # A byte order of its own is what the peers' tensors cannot take.
        plain = np.ascontiguousarray(item, item.dtype.newbyteorder("<"))
        yield from _array(plain.shape, plain.dtype, _bytes(plain))
    yield CODE["APPENDS"]


def _array(shape: tuple[int, ...], dtype: np.dtype[Any], content: Iterator[Piece]) -> Iterator[Piece]:
    """`_reconstruct(ndarray, (0,), b"b")` and the state (1, shape, dtype, not Fortran, content)."""
    yield _name("numpy.core.multiarray", "_reconstruct") + _name("numpy", "ndarray") + _integer(0) + CODE["TUPLE1"]
    yield CODE["SHORT_BINBYTES"] + b"\x01b" + CODE["TUPLE3"] + CODE["REDUCE"]
    yield CODE["MARK"] + _integer(1)
    yield CODE["MARK"] + b"".join(map(_integer, shape)) + CODE["TUPLE"]
    yield _dtype(dtype) + CODE["NEWFALSE"]
    yield from content
    yield CODE["TUPLE"] + CODE["BUILD"]


def _bytes(array: NDArray[Any]) -> Iterator[Piece]:
    yield CODE["BINBYTES8"] + struct.pack("<Q", array.nbytes)
    yield array.reshape(-1).view(np.uint8).data


def _dtype(dtype: np.dtype[Any]) -> bytes:
    """`dtype("f4", False, True)` and the state (3, order, None, None, None, -1, -1, flags)."""
    text = _text(dtype.str[1:] if not dtype.hasobject else "O8")
    order, flags = ("|", 63) if dtype.hasobject else (dtype.str[0], 0)
    made = _name("numpy", "dtype") + text + CODE["NEWFALSE"] + CODE["NEWTRUE"] + CODE["TUPLE3"] + CODE["REDUCE"]
    state = _integer(3) + _text(order) + CODE["NONE"] * 3 + _integer(-1) * 2 + _integer(flags)
    return made + CODE["MARK"] + state + CODE["TUPLE"] + CODE["BUILD"]


def _name(module: str, name: str) -> bytes:
    return CODE["GLOBAL"] + f"{module}\n{name}\n".encode("ascii")


def _text(text: str) -> bytes:
    return CODE["BINUNICODE"] + struct.pack("<I", len(text)) + text.encode("ascii")


def _integer(value: int) -> bytes:
    return CODE["BININT"] + struct.pack("<i", value)
