"""What is done to a valid file: to its bytes, its tables, its arrays."""

import copy
import io
import json
import zipfile
from typing import Any

import numpy as np
import tomli_w
from hypothesis import strategies as st

ABSURD: tuple[Any, ...] = (
    *(0, -1, 1, 2, 3, 2**31, 2**63, 2**64, -(2**63), 10**30, 10**400, True, False),
    *(0.0, -0.0, -1.0, 1e-300, 1e-12, 1e-7, 1e-3, 0.5, 1e3, 1e7, 1e9, 1e12, 1e30, 1e38, 1e155, 1e300, -1e300),
    *(float("inf"), float("-inf"), float("nan"), 0.4999999999, 89.99999999),
    *(
        "",
        "a",
        "all",
        "no-slip",
        "elastic",
        "settled",
        "x-",
        "\x00",
        "é" * 300,
        "../../../../etc/passwd",
        "/dev/zero",
        ".",
    ),
    *("box", "polygon", "mesh", "layer", "particles", "terrain", "ground.csv", "dem.asc", "block.stl", "1e5"),
    *([], [[]], [0.0], [0.0, 0.0], [1e300, 1e300], [0.0, 0.0, 0.0], ["a"], [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], {}),
    *({"a": 1}, [{}], [[1e300, 0.0], [0.0, 1e300], [0.0, 0.0]], [0.0] * 2000),
)
"""Values in place of others."""
FEW = st.sampled_from((1, 1, 1, 2, 2, 4))
"""How often something is changed: what is broken twice is mostly refused for the first reason."""
BYTES = (
    b"",
    b"\0",
    b"\xff" * 8,
    b"\0" * 8,
    b"9" * 400,
    b"[" * 3000,
    b"{" * 3000,
    b"nan",
    b"1e999",
    b"-",
    b"\n",
    b'"',
    b"PK\5\6",
)


def paths(data: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The paths to everything in nested tables and lists, tables and lists themselves too."""
    found = [path] if path else []
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        found += paths(value, (*path, key))
    return found


@st.composite
def tables(
    draw: st.DrawFn, bases: tuple[dict[str, Any], ...], spare: tuple[dict[str, Any], ...] = ()
) -> dict[str, Any]:
    """A table with one to four of its places changed, taken away, doubled, scaled or renamed."""
    data = copy.deepcopy(draw(st.sampled_from(bases)))
    for _ in range(draw(FEW)):
        known = paths(data)
        if not known:
            break
        path = draw(st.sampled_from(known))
        parent = data
        for key in path[:-1]:
            parent = parent[key]
        value = parent[path[-1]]
        match draw(st.integers(0, 7)):
            case 0 | 1:
                parent[path[-1]] = copy.deepcopy(draw(st.sampled_from(ABSURD)))
            case 2 | 3 if isinstance(value, int | float) and not isinstance(value, bool):
                parent[path[-1]] = value * draw(
                    st.sampled_from((-1, 1e-9, 1e-3, 0.5, 1.0000001, 2, 3, 10, 1e3, 1e6, 1e9))
                )
            case 4 if isinstance(parent, dict):
                del parent[path[-1]]
            case 5 if isinstance(parent, list):
                parent.insert(path[-1], copy.deepcopy(value))
            case 6 if isinstance(parent, dict) and spare:
                parent.update(copy.deepcopy(draw(st.sampled_from(spare))))
            case 7 if isinstance(parent, dict):
                parent[str(path[-1]) + draw(st.sampled_from(("s", "_", ".a", " ", "\u200b")))] = parent.pop(path[-1])
            case _:
                parent[path[-1]] = draw(st.floats() | st.integers() | st.text(max_size=5))
    return data


def toml(data: dict[str, Any]) -> bytes:
    """As TOML; what it cannot say is left as text."""
    try:
        return tomli_w.dumps(data).encode("utf-8", "surrogatepass")
    except (TypeError, ValueError):
        return json.dumps(data, default=str).encode()


@st.composite
def damaged(draw: st.DrawFn, wholes: tuple[bytes, ...]) -> bytes:
    """A file with some of its bytes changed, cut out, doubled or put in."""
    content = bytearray(draw(st.sampled_from(wholes)))
    for _ in range(draw(FEW)):
        size = max(1, len(content))
        # Half of the damage near the ends, where archives and headers say what they are.
        near = draw(st.integers(0, min(size, 400) - 1))
        index = (
            draw(st.sampled_from((near, size - 1 - near))) if draw(st.booleans()) else draw(st.integers(0, size - 1))
        )
        match draw(st.integers(0, 6)):
            case 0:
                content[index : index + 1] = bytes([draw(st.integers(0, 255))])
            case 1:
                content[index : index + 1] = bytes(
                    [(content[index] if index < len(content) else 0) ^ 1 << draw(st.integers(0, 7))]
                )
            case 2:
                del content[index : index + draw(st.sampled_from((1, 2, 8, 30, 1000)))]
            case 3:
                content[index:index] = content[index : index + draw(st.sampled_from((1, 2, 8, 30, 1000)))]
            case 4:
                content[index:index] = draw(st.sampled_from(BYTES))
            case 5:
                number = draw(st.sampled_from((0, 1, 255, 65535, 2**31 - 1, 2**32 - 1)))
                content[index : index + 4] = number.to_bytes(4, draw(st.sampled_from(("little", "big"))))
            case _:
                number = draw(st.sampled_from((2**31, 2**40, 2**63 - 1, 2**64 - 1)))
                content[index : index + 8] = number.to_bytes(8, "little")
    return bytes(content)


@st.composite
def arrays(draw: st.DrawFn, base: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Arrays of which some are lost, renamed, of another shape, type or content."""
    data = dict(base)
    for _ in range(draw(FEW)):
        key = draw(st.sampled_from(sorted(data))) if data else ""
        if not key:
            break
        array = data[key]
        match draw(st.integers(0, 8)):
            case 0:
                del data[key]
            case 1:
                data[key + "_"] = data.pop(key)
            case 2:
                data[key] = array[..., None]
            case 3 if array.ndim:
                data[key] = array[: draw(st.sampled_from((0, 1, 2)))]
            case 4:
                kinds = (np.float16, np.float64, np.int8, np.int64, np.uint8, bool, np.complex64, "S3", "U3", ">f4")
                with np.errstate(all="ignore"):
                    data[key] = np.zeros(array.shape, draw(st.sampled_from(kinds)))
            case 5 | 6 if array.dtype.kind in "fiu" and array.size:
                array = array.copy()
                value = draw(st.sampled_from((np.nan, np.inf, -np.inf, -1.0, 0.0, 1e30, 3e38, 2.0**31)))
                with np.errstate(all="ignore"):
                    flat = array.reshape(-1)
                    flat[draw(st.integers(0, flat.size - 1)) :: draw(st.sampled_from((1, 7, 10**6)))] = np.float64(
                        value
                    ).astype(array.dtype)
                data[key] = array
            case 7:
                data[key] = np.array(
                    draw(st.sampled_from(("", "{}", "[]", "null", "[" * 5000, '{"a":1e999}', "9" * 5000, "\x00")))
                )
            case _:
                data[key] = np.array(draw(st.floats() | st.integers(-(2**31), 2**31 - 1)))
    return data


def npz(data: dict[str, np.ndarray], *, compressed: bool = False) -> bytes:
    """As an NPZ."""
    file = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(file, **data)
    return file.getvalue()


@st.composite
def archives(draw: st.DrawFn, bases: tuple[dict[str, bytes], ...]) -> bytes:
    """A zip archive of right checksums whose members are damaged."""
    members = dict(draw(st.sampled_from(bases)))
    name = draw(st.sampled_from(sorted(members)))
    members[name] = draw(damaged((members[name],)))
    file = io.BytesIO()
    kind = draw(st.sampled_from((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2)))
    with zipfile.ZipFile(file, "w", kind) as archive:
        for member, content in members.items():
            archive.writestr(member, content)
    return file.getvalue()


def members_of(content: bytes) -> dict[str, bytes]:
    """The members of an archive by name."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}
