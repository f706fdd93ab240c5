"""A pickle gives its arrays, whatever protocol and numpy wrote it; anything else is refused and nothing of it runs."""

import builtins
import copyreg
import datetime
import functools
import io
import os
import pickle
import pickletools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datasets.untrusted.pickles import Refused, read_pickle

NUMPY = "numpy.core.multiarray"
CODE = {opcode.name: opcode.code.encode("latin-1") for opcode in pickletools.opcodes}


def read(content: bytes) -> Any:
    return read_pickle(io.BytesIO(content), len(content))


def refused(content: bytes) -> str:
    with pytest.raises(ValueError, match=r".") as caught:
        read(content)
    assert len(str(caught.value)) < 300
    return str(caught.value)


def trajectories() -> np.ndarray:
    stream = np.random.default_rng(0)
    data = np.empty(3, dtype=object)
    data[0] = (stream.random((4, 5, 2)), np.full(5, 6), stream.random(5).astype(np.float32))
    data[1] = (np.asfortranarray(stream.random((4, 5, 3)).astype(np.float32)), 6, 0.5)
    data[2] = (stream.random((2, 3, 2)).astype(">f4"), np.int32(6), np.float32(0.25))
    return data


def same(a: Any, b: Any) -> None:
    assert isinstance(a, np.ndarray) == isinstance(b, np.ndarray)
    if isinstance(b, tuple | list) or (isinstance(b, np.ndarray) and b.dtype.hasobject):
        assert len(a) == len(b)
        for each, other in zip(a, b, strict=True):
            same(each, other)
    else:
        assert np.asarray(a).dtype == np.asarray(b).dtype.newbyteorder("=")
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("protocol", [2, 3, 4])
def test_trajectories_of_every_protocol(protocol: int) -> None:
    same(read(pickle.dumps(trajectories(), protocol)), trajectories())


def test_the_names_of_older_and_newer_numpy() -> None:
    content = pickle.dumps(trajectories(), 3)
    assert b"numpy._core.multiarray" in content
    same(read(content.replace(b"numpy._core.multiarray", b"numpy.core.multiarray")), trajectories())


@pytest.mark.parametrize("code", ["?", "i1", "u2", "i4", "u8", "f2", "f4", "f8", ">i8"])
def test_dtypes_of_numbers(code: str) -> None:
    array = np.arange(6).reshape(2, 3).astype(code)
    same(read(pickle.dumps(array, 4)), array)


def test_lists_nests_and_numbers() -> None:
    value = [np.arange(3.0), [1, 2.5, (True, -7)], np.float64(0.5), 10**30]
    same(read(pickle.dumps(value, 4)), value)


def test_an_array_that_occurs_twice() -> None:
    array = np.arange(3.0)
    same(read(pickle.dumps([array, array], 4)), [array, array])


class Calls:
    """Pickles as a call of anything."""

    def __init__(self, function: Callable[..., Any], *arguments: Any) -> None:
        self.call = (function, arguments)

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return self.call


def hostile(mark: Path) -> dict[str, Any]:
    touch = f"open({str(mark)!r}, 'w')"
    return {
        "os.system": Calls(os.system, f"touch {mark}"),
        "eval": Calls(builtins.eval, touch),
        "exec": Calls(builtins.exec, touch),
        "getattr": Calls(builtins.getattr, Calls(builtins.__import__, "os"), "system"),
        "partial": Calls(functools.partial, os.system, f"touch {mark}"),
        "copyreg": Calls(copyreg._reconstructor, Path, object, None),  # type: ignore[attr-defined]
        "numpy.load": Calls(np.load, str(mark)),
        "a path": mark,
        "a date": datetime.date(2020, 1, 1),
        "a dict": {"a": np.arange(3)},
        "a set": {1, 2},
        "text": "sand",
        "bytes": b"sand",
        "None": None,
        "structured": np.zeros(2, [("x", "f4")]),
        "fields of objects": np.zeros(2, [("x", "O")]),
        "dates": np.zeros(2, "M8[s]"),
        "text array": np.array(["sand"]),
        "bytearray": bytearray(b"sand"),
        "a dtype": np.dtype("f4"),
        "the class of arrays": np.ndarray,
        "long doubles": np.zeros(2, np.longdouble),
        "complex": np.zeros(2, complex),
        "objects of objects": np.array([Calls(os.system, f"touch {mark}"), 1], dtype=object),
    }


@pytest.mark.parametrize("protocol", [2, 4, 5])
@pytest.mark.parametrize("name", hostile(Path("mark")))
def test_hostile_values_are_refused_and_do_not_run(name: str, protocol: int, tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    value = hostile(mark)[name]
    assert "found" in refused(pickle.dumps(value, protocol))
    assert "found" in refused(pickle.dumps([np.arange(3.0), (value,)], protocol))
    assert not mark.exists()


def op(*pieces: str | bytes) -> bytes:
    """A pickle of opcodes by name and of raw arguments."""
    return b"\x80\x04" + b"".join(CODE[piece] if isinstance(piece, str) else piece for piece in pieces) + b"."


def text(value: str) -> bytes:
    return CODE["SHORT_BINUNICODE"] + bytes([len(value)]) + value.encode()


def name(module: str, attribute: str) -> bytes:
    return CODE["GLOBAL"] + f"{module}\n{attribute}\n".encode()


EMPTY = name(NUMPY, "_reconstruct") + op("EMPTY_TUPLE")[2:-1]
ARRAY = (
    name(NUMPY, "_reconstruct")
    + name("numpy", "ndarray")
    + op("BININT1", b"\0", "TUPLE1", "SHORT_BINBYTES", b"\1b", "TUPLE3", "REDUCE")[2:-1]
)
F8 = name("numpy", "dtype") + text("f8") + op("NEWFALSE", "NEWTRUE", "TUPLE3", "REDUCE")[2:-1]


def state(shape: bytes, dtype: bytes, content: bytes) -> bytes:
    return op("MARK", "BININT1", b"\1", shape, dtype, "NEWFALSE", content, "TUPLE", "BUILD")[2:-1]


def dtype_state(order: bytes = text("<"), rest: str = "NONE") -> bytes:
    minus = CODE["BININT"] + b"\xff\xff\xff\xff"
    return op("MARK", "BININT1", b"\3", order, "NONE", rest, "NONE", minus, minus, "BININT1", b"\0", "TUPLE", "BUILD")[
        2:-1
    ]


EIGHT = CODE["SHORT_BINBYTES"] + b"\x08" + bytes(8)
ONE = CODE["BININT1"] + b"\1" + CODE["TUPLE1"]


def test_the_hand_made_array_is_one() -> None:
    same(read(op(ARRAY, state(ONE, F8 + dtype_state(), EIGHT))), np.zeros(1))


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (op(name("os", "system"), text("true"), "TUPLE1", "REDUCE"), "os.system"),
        (op(text("os"), text("system"), "STACK_GLOBAL"), "os.system"),
        (op(text("numpy.core.multiarray"), text("scalar.__globals__"), "STACK_GLOBAL"), "__globals__"),
        (op(text("numpy"), text("ndarray.__class__"), "STACK_GLOBAL"), "__class__"),
        (op(text("numpy"), "BININT1", b"\1", "STACK_GLOBAL"), "whole pickle"),
        (op(name("numpy", "ndarray"), "EMPTY_TUPLE", "REDUCE"), "no function"),
        (op(name("numpy", "ndarray"), "EMPTY_TUPLE", "NEWOBJ"), "NEWOBJ"),
        (op("MARK", name("numpy", "ndarray"), "OBJ"), "OBJ"),
        (op("MARK", b"ios\nsystem\n"), "INST"),
        (op(text("here"), "BINPERSID"), "BINPERSID"),
        (op(b"Phere\n"), "PERSID"),
        (op("EXT1", b"\1"), "EXT1"),
        (op("EXT4", b"\1\0\0\0"), "EXT4"),
        (op("NEXT_BUFFER"), "NEXT_BUFFER"),
        (op("EMPTY_DICT"), "EMPTY_DICT"),
        (op(b"I1\n"), "INT"),
        (op(b"S'sand'\n"), "STRING"),
        (op(ARRAY), "before it is complete"),
        (op("EMPTY_LIST", ARRAY, "APPEND"), "before it is complete"),
        (
            op(ARRAY, "BINPUT", b"\0", state(ONE, F8 + dtype_state(), op("BINGET", b"\0")[2:-1])),
            "match its bytes",
        ),
        (op(EMPTY, "REDUCE"), "reconstruct"),
        (op(ARRAY, state(ONE, F8 + dtype_state(), EIGHT), "NONE", "BUILD"), "no plain array"),
        (
            op(ARRAY, "MEMOIZE", state(ONE, F8 + dtype_state(), EIGHT), "BINGET", b"\0", "NONE", "BUILD"),
            "no plain array",
        ),
        (op(ARRAY, *[state(ONE, F8 + dtype_state(), EIGHT)] * 2), "second state"),
        (op("EMPTY_LIST", "NONE", "BUILD"), "no plain array"),
        (op(ARRAY, state(ONE, F8 + dtype_state(text("!")), EIGHT)), "no plain array"),
        (op(ARRAY, state(ONE, F8 + dtype_state(rest="EMPTY_TUPLE"), EIGHT)), "no plain array"),
        (
            op(name("numpy", "dtype"), text("O"), "NEWFALSE", "NEWTRUE", "TUPLE3", "REDUCE", dtype_state()),
            "neither an array",
        ),
        (op(name("numpy", "dtype"), text("f16"), "NEWFALSE", "NEWTRUE", "TUPLE3", "REDUCE"), "dtype"),
        (op(name("numpy", "dtype"), text("f4,O"), "NEWFALSE", "NEWTRUE", "TUPLE3", "REDUCE"), "dtype"),
        (op(ARRAY, state(op("BININT1", b"\2", "TUPLE1")[2:-1], F8 + dtype_state(), EIGHT)), "match its bytes"),
        (op(ARRAY, state(op("BININT", b"\xff\xff\xff\xff", "TUPLE1")[2:-1], F8 + dtype_state(), EIGHT)), "shape"),
        (op(ARRAY, state(op("LONG1", b"\x08", bytes(6), b"\0\1", "TUPLE1")[2:-1], F8 + dtype_state(), EIGHT)), "shape"),
        (op(ARRAY, state(text("1"), F8 + dtype_state(), EIGHT)), "no plain array"),
        (op(ARRAY, state(ONE, F8 + dtype_state(), op("EMPTY_LIST")[2:-1])), "match its bytes"),
        (op(name(NUMPY, "scalar"), F8, dtype_state(), "SHORT_BINBYTES", b"\1a", "TUPLE2", "REDUCE"), "scalar"),
        (op(name("_codecs", "encode"), text("a"), text("zlib"), "TUPLE2", "REDUCE"), "encode"),
        (op(text("a"), "EMPTY_TUPLE", "REDUCE"), "no function"),
        (op("BINGET", b"\7"), "whole pickle"),
        (op("MEMOIZE"), "whole pickle"),
        (op("APPENDS"), "whole pickle"),
        (op("TUPLE3"), "whole pickle"),
        (op("MARK", "TUPLE1"), "whole pickle"),
        (op("EMPTY_LIST", "EMPTY_LIST"), "more than one"),
        (op(), "whole pickle"),
        (op("NEWTRUE", "NEWTRUE", "APPEND"), "whole pickle"),
        (b"", "whole pickle"),
        (b"\x80\x04K\1", "whole pickle"),
        (b"\x80\x04\xff.", "opcode"),
        (b"\x80\x09.", "protocol"),
        (op("BINBYTES8", (2**62).to_bytes(8, "little"), b"abc"), "whole pickle"),
    ],
)
def test_hostile_opcodes_are_refused(content: bytes, found: str) -> None:
    assert found in refused(content)


def test_a_list_that_holds_itself_ends() -> None:
    holds_itself: list[Any] = [np.arange(3.0)]
    holds_itself.append(holds_itself)
    again = read(pickle.dumps(holds_itself, 4))
    assert again[1] is again


def test_a_short_pickle_cannot_ask_for_much() -> None:
    # A kept text, encoded again and again: each time a copy, of eight bytes of pickle.
    kept = CODE["BINUNICODE"] + (10_000).to_bytes(4, "little") + b"a" * 10_000 + CODE["BINPUT"] + b"\0"
    again = name("_codecs", "encode") + op("BINGET", b"\0")[2:-1] + text("latin1") + op("TUPLE2", "REDUCE")[2:-1]
    assert "more elements" in refused(op(kept, *[again] * 100))
    # A list of ten thousand, made into object arrays.
    o8 = name("numpy", "dtype") + text("O8") + op("NEWFALSE", "NEWTRUE", "TUPLE3", "REDUCE")[2:-1] + dtype_state()
    many = op("EMPTY_LIST", "BINPUT", b"\0", "MARK", *["NEWTRUE"] * 10_000, "APPENDS")[2:-1]
    shape = op("BININT2", (10_000).to_bytes(2, "little"), "TUPLE1")[2:-1]
    one = op(ARRAY, state(shape, o8, op("BINGET", b"\0")[2:-1]))[2:-1]
    assert "more elements" in refused(op(many, *[one] * 10))


def test_too_many_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("datasets.untrusted.pickles.MOST_READS", 100)
    assert "at most 100 pieces" in refused(op("EMPTY_LIST", "MARK", *["NEWTRUE"] * 100, "APPENDS"))


def test_refusals_differ_from_broken_pickles() -> None:
    with pytest.raises(Refused):
        read(op("EMPTY_DICT"))
