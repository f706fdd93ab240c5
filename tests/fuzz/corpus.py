"""What once fell, as it is made: names and contents of files by kind. Every one must be refused in a line."""

import io
import json
import pickle
import pickletools
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Callable
from typing import Any

import h5py
import numpy as np

from tests.fuzz import mutations, seeds
from tests.fuzz.asking import MARK

OPCODE = {each.name: each.code.encode("latin-1") for each in pickletools.opcodes}


def corpus() -> dict[str, Callable[[], dict[str, tuple[str, bytes]]]]:
    """Kind -> what makes its files: what each is -> name and content."""
    return {
        "scene": scenes,
        "problem": problems,
        "trajectory": archives,
        "foreign": pickles,
        "model": models,
        "run": runs,
        "hdf5": containers,
        "raster": rasters,
        "mesh": meshes,
        "csv": tables,
        "state": states,
    }


def changed(base: dict[str, Any], **changes: Any) -> tuple[str, bytes]:
    """A scene with other values at dotted keys, `_` for the dot."""
    data = json.loads(json.dumps(base))
    for key, value in changes.items():
        *tables, last = key.split("__")
        table = data
        for each in tables:
            table = table[int(each) if each.isdigit() else each]
        table[last] = value
    return "scene.toml", mutations.toml(data)


def scenes() -> dict[str, tuple[str, bytes]]:
    column = seeds.COLUMN
    plain = mutations.toml(column)
    return {
        "deep lists": ("scene.toml", b"seed = " + b"[" * 100_000 + b"]" * 100_000),
        "deep lists that the parser bears": ("scene.toml", b"seed = " + b"[" * 200 + b"]" * 200 + b"\n" + plain),
        "deep tables": ("scene.toml", b"seed = " + b"{a=" * 5000 + b"1" + b"}" * 5000),
        "a key of many parts": ("scene.toml", b".".join([b"a"] * 50_000) + b" = 1"),
        "a table of many parts": ("scene.toml", b"[" + b".".join([b"a"] * 50_000) + b"]"),
        "an integer of 5000 digits": ("scene.toml", b"seed = " + b"9" * 5000 + b"\n" + plain),
        "an integer of 9000 hex digits": ("scene.toml", b"frames = 0x" + b"f" * 9000 + b"\n" + plain),
        "58 TiB of particles": changed(column, domain__cell=1e-6, domain__size=[0.4, 0.2]),
        "cells of 1e-12": changed(column, domain__cell=1e-12),
        "more cells than 32 bits count": changed(column, domain__cell=1e-5, domain__size=[1.0, 1.0]),
        "no cells": changed(column, domain__size=[1e-12, 1e-12]),
        "stiffness 1e300": changed(column, material__young=1e300),
        "density 1e-300": changed(column, material__density=1e-300),
        "poisson 0.49999999": changed(column, material__poisson=0.49999999),
        "duration 1e9": changed(column, duration=1e9),
        "duration 1e9 in few frames": changed(column, duration=1e9, frame_dt=1e8),
        "1e9 frames": changed(column, duration=0.02, frame_dt=2e-11),
        "infinitely many frames": changed(column, duration=1e300, frame_dt=1e-300),
        "no frames": changed(column, duration=1e-9),
        "a velocity of 1e300": changed(column, masses__0__velocity=[1e300, 0.0]),
        "a million particles per axis": changed(column, particles_per_axis=1_000_000),
        "gravity 1e300": changed(column, gravity=1e300),
        "vertices at 1e300": changed(seeds.SHAPES, solids__1__vertices=[[0.2, 0.0], [1e300, 0.0], [0.23, 1e300]]),
        "a layer of a thin lattice": changed(seeds.SHAPES, particles_per_axis=1000, domain__cell=0.001),
        "a file that never ends": changed(seeds.NAMING, solids__0__file="/dev/zero"),
        "a terrain that is a folder": changed(seeds.NAMING, solids__0__file="."),
        "a file with no name": changed(seeds.NAMING, masses__0__file="\x00.csv"),
        "a name of 5000 letters": changed(seeds.NAMING, masses__0__file="a" * 5000 + ".csv"),
        "bytes that are no text": ("scene.toml", b"\xff\xfe\x00seed"),
        "many bodies": changed(column, masses=[{"lower": [0.0, 0.0], "size": [0.1, 0.1]}] * 5000),
    }


def problems() -> dict[str, tuple[str, bytes]]:
    base = seeds.PROBLEMS[0]
    name = "problem.toml"
    return {
        "deep lists": (name, b"scene = " + b"[" * 100_000),
        "a scene that is itself": (name, mutations.toml(base | {"scene": name})),
        "a scene that is a device": (name, mutations.toml(base | {"scene": "/dev/zero.toml"})),
        "bounds of 1e300": (
            name,
            mutations.toml(base | {"unknowns": [seeds.UNKNOWN | {"lower": -1e300, "upper": 1e300}]}),
        ),
        "an observation of 1e300": (name, mutations.toml(base | {"observation": {"kind": ["front"]}})),
        "a million unknowns of one name": (name, mutations.toml(base | {"unknowns": [seeds.UNKNOWN] * 2000})),
    }


def zipped(members: dict[str, bytes], kind: int = zipfile.ZIP_DEFLATED) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", kind) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return file.getvalue()


def npy(shape: tuple[int, ...], content: bytes, kind: str = "<f4") -> bytes:
    header = repr({"descr": kind, "fortran_order": False, "shape": shape}).encode()
    return b"\x93NUMPY\1\0" + len(header).to_bytes(2, "little") + header + content


def patched(content: bytes, signature: bytes, offset: int, value: bytes) -> bytes:
    """An archive in which every record with a signature says something else."""
    data, start = bytearray(content), 0
    while (start := data.find(signature, start)) >= 0:
        data[start + offset : start + offset + len(value)] = value
        start += 4
    return bytes(data)


def archives() -> dict[str, tuple[str, bytes]]:
    whole = mutations.npz(seeds.trajectory(), compressed=True)
    members = mutations.members_of(whole)
    zeros = zipped(members | {"positions.npy": npy((5, 2**22, 2), bytes(5 * 2**25))})
    return {
        "a bomb": ("flow.npz", zeros),
        "zip file version 10.9": ("flow.npz", patched(whole, b"PK\1\2", 6, b"\x6d\0")),
        "invalid block type": ("flow.npz", patched(whole, b"PK\3\4", 30 + len("positions.npy") + 20, b"\xff" * 8)),
        "a strange compression": ("flow.npz", patched(whole, b"PK\1\2", 10, b"\x63\0")),
        "lzma": ("flow.npz", zipped(members, zipfile.ZIP_LZMA)),
        "encrypted": ("flow.npz", patched(whole, b"PK\1\2", 8, b"\1\0")),
        "a member of 2^40 bytes": ("flow.npz", patched(whole, b"PK\1\2", 24, b"\xfe\xff\xff\xff")),
        "a directory that is not there": ("flow.npz", patched(whole, b"PK\5\6", 16, b"\xff\xff\xff\x7f")),
        "nan positions": (
            "flow.npz",
            mutations.npz({**seeds.trajectory(), "positions": np.full((3, 8, 2), np.nan, np.float32)}),
        ),
        "time that falls": ("flow.npz", mutations.npz({**seeds.trajectory(), "time": np.array([0.0, 2.0, 1.0])})),
        "a scene of deep lists": ("flow.npz", mutations.npz({**seeds.trajectory(), "scene": np.array("[" * 50_000)})),
        "a summary of deep lists": (
            "flow.npz",
            mutations.npz({**seeds.trajectory(), "summary": np.array('{"a":' * 50_000)}),
        ),
        "a shape that overflows": ("flow.npz", zipped(members | {"positions.npy": npy((2**40, 2**40, 2), b"")})),
        "objects": ("flow.npz", mutations.npz({**seeds.trajectory(), "friction": np.array([None, {}], object)})),
        "a directory of a million entries": ("flow.npz", entries(600_000)),
    }


def entries(count: int) -> bytes:
    """An archive whose directory has `count` entries of nothing."""
    entry = struct.pack("<4s4B4HL2L5H2L", b"PK\1\2", 20, 0, 20, 0, 0, 0, 0, 33, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0) + b"a"
    directory = entry * count
    return directory + struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, count % 2**16, count % 2**16, len(directory), 0, 0)


def pickled(content: bytes, shape: tuple[int, ...] = (3,)) -> bytes:
    return zipped({"simulation_0.npy": npy(shape, content, "|O")})


class Executes:
    """An object whose pickle makes the mark."""

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return open, (MARK, "w")


def pickles() -> dict[str, tuple[str, bytes]]:
    copies = b"\x80\x04" + b"(" + b"X" + (2**22).to_bytes(4, "little") + bytes(2**22) + b"q\0"
    code = OPCODE["GLOBAL"] + b"_codecs\nencode\n" + OPCODE["BINGET"] + b"\0" + OPCODE["BINUNICODE"] + b"\6\0\0\0latin1"
    again = copies + (code + OPCODE["TUPLE2"] + OPCODE["REDUCE"]) * 4000 + b"t."
    array = pickle.dumps(np.zeros(2**20), 4)
    return {
        "what executes": ("train.npz", pickled(pickle.dumps(Executes()))),
        "what executes, in an array": ("train.npz", pickled(pickle.dumps(np.array([Executes(), 1, 2], object)))),
        "14 KB that copy for ever": ("train.npz", pickled(again)),
        "millions of empty lists": ("train.npz", pickled(b"\x80\x04(" + b"]" * 3_000_000 + b"t.")),
        "millions of kept numbers": ("train.npz", pickled(b"\x80\x04(" + b"K\1\x94" * 1_000_000 + b"t.")),
        "a long integer": (
            "train.npz",
            pickled(b"\x80\x04\x8b" + (2**22).to_bytes(4, "little") + b"\x7f" * 2**22 + b"."),
        ),
        "an array of an array": ("train.npz", pickled(array)),
        "deep tuples": ("train.npz", pickled(b"\x80\x04K\1" + b"\x85" * 200_000 + b".")),
        "a bomb": ("train.npz", pickled(bytes(5 * 2**25))),
    }


def models() -> dict[str, tuple[str, bytes]]:
    whole = seeds.model()
    header, tensors = seeds.parsed(whole)
    settings, name = seeds.settings_of(whole), "model.safetensors"
    nan = np.frombuffer(tensors, np.float32).copy()
    nan[7] = np.nan
    tar = io.BytesIO()
    with tarfile.open(fileobj=tar, mode="w") as archive:
        archive.addfile(tarfile.TarInfo("pickle"))
    metadata = header["__metadata__"]

    def with_metadata(**changes: Any) -> bytes:
        return seeds.joined({**header, "__metadata__": metadata | changes}, tensors)

    return {
        "a tar": (name, tar.getvalue()),
        "a zip bomb of torch": (name, zipped({"archive/data.pkl": bytes(2**24)})),
        "a pickle of torch's": (name, pickle.dumps(Executes())),
        "nan weights": (name, seeds.joined(header, nan.tobytes())),
        "a header of 2^63 bytes": (name, (2**63).to_bytes(8, "little") + whole[8:]),
        "a header of deep lists": (name, (200_008).to_bytes(8, "little") + b'{"a":   ' + b"[" * 200_000),
        "settings of deep lists": (name, with_metadata(settings="[" * 100_000)),
        "provenance of deep tables": (name, with_metadata(provenance='{"a":' * 300 + "1" + "}" * 300)),
        "no settings": (name, with_metadata(settings="")),
        **{
            f"{key} {value}": (name, seeds.with_settings(whole, settings | {key: value}))
            for key, value in (
                *(
                    ("layers", 1_000_000),
                    ("width", 10**9),
                    ("history", 10**9),
                    ("rounds", 0),
                    ("layers", 0),
                    ("rounds", 7),
                ),
                *(
                    ("mlp_layers", 10**6),
                    ("grid_layers", 10**6),
                    ("frames_per_step", 0),
                    ("cell", 0.0),
                    ("radius", 1e300),
                ),
                *(
                    ("frame_dt", 1e-300),
                    ("density", 0.0),
                    ("density", -1.0),
                    ("grid_cell", 1e-9),
                    ("body_length", 1e300),
                ),
                *(("dimension", 7), ("cell", 1e-30), ("particles_per_cell", 0), ("rest_speed", -1.0)),
            )
        },
    }


def runs() -> dict[str, tuple[str, bytes]]:
    whole, name = seeds.run(), "last.safetensors"
    header, tensors = seeds.parsed(whole)
    described = json.loads(header["__metadata__"]["run"])
    numbers = np.frombuffer(tensors[: len(tensors) // 4 * 4], np.float32).copy()
    numbers[:] = np.nan

    def stated(**changes: Any) -> bytes:
        metadata = {**header["__metadata__"], "run": json.dumps(described | changes)}
        return seeds.joined({**header, "__metadata__": metadata}, tensors)

    return {
        "a file of torch": (name, zipped({"archive/data.pkl": pickle.dumps(Executes())}, zipfile.ZIP_STORED)),
        "a pickle": (name, pickle.dumps(Executes())),
        "nan weights": (name, seeds.joined(header, numbers.tobytes() + tensors[len(numbers) * 4 :])),
        "a negative position": (name, stated(position={"updates": -5})),
        "a position that is a list": (name, stated(position=[1, 2])),
        "1,000,000 layers": (name, stated(settings=described["settings"] | {"layers": 1_000_000})),
        "a model": (name, seeds.model()),
    }


def containers() -> dict[str, tuple[str, bytes]]:
    def file(make: Callable[[Any], object]) -> tuple[str, bytes]:
        content = io.BytesIO()
        with h5py.File(content, "w") as opened:
            group = opened.create_group("00000")
            group["particle_type"] = np.zeros(6, np.int32)
            make(group)
        return "train.h5", content.getvalue()

    def virtual(group: Any) -> None:
        layout = h5py.VirtualLayout(shape=(4, 6, 2), dtype="f4")
        layout[:] = h5py.VirtualSource("/etc/passwd", "a", shape=(4, 6, 2))
        group.create_virtual_dataset("position", layout)

    huge = (2**20, 2**15, 2)
    return {
        "a dataset of terabytes": file(
            lambda group: group.create_dataset("position", huge, "f4", chunks=(1, 2**10, 2))
        ),
        "gigabytes of nothing": file(
            lambda group: group.create_dataset("position", (2**10, 2**19, 2), "f4", chunks=(1, 2**10, 2))
        ),
        "gigabytes compressed": file(
            lambda group: group.create_dataset("position", data=np.zeros((2**9, 2**16, 2), "f4"), compression="gzip")
        ),
        "another file": file(
            lambda group: group.create_dataset("position", (4, 6, 2), "f4", external=[("/etc/passwd", 0, 192)])
        ),
        "a link to another file": file(
            lambda group: group.__setitem__("position", h5py.ExternalLink("/etc/passwd", "/"))
        ),
        "a soft link": file(lambda group: group.__setitem__("position", h5py.SoftLink("/00000/particle_type"))),
        "a virtual dataset": file(virtual),
        "text": file(lambda group: group.create_dataset("position", data="text")),
        "a group": file(lambda group: group.create_group("position")),
        "nothing": ("train.h5", b""),
    }


def rasters() -> dict[str, tuple[str, bytes]]:
    head = "ncols {}\nnrows {}\nxllcorner 0\nyllcorner 0\ncellsize 1\n"
    vrt = '<VRTDataset rasterXSize="5" rasterYSize="5"><VRTRasterBand dataType="Byte" band="1"><SimpleSource>'
    vrt += '<SourceFilename relativeToVRT="0">/vsicurl/http://127.0.0.1:9/a.tif</SourceFilename></SimpleSource>'
    return {
        "a raster of 10^18 values": ("dem.asc", head.format(10**9, 10**9).encode() + b"1 2 3\n"),
        "a raster of 10^10 values": ("dem.asc", head.format(10**5, 10**5).encode() + b"1 2 3\n"),
        "a sparse GeoTIFF of 40 GB": ("dem.tif", sparse_tiff(100_000)),
        "another file": ("dem.tif", vrt.encode() + b"</VRTRasterBand></VRTDataset>"),
        "a cell size of nan": ("dem.asc", b"ncols 2\nnrows 2\nxllcorner nan\nyllcorner 0\ncellsize nan\n1 2\n3 4\n"),
        "nothing": ("dem.tif", b""),
    }


def sparse_tiff(side: int) -> bytes:
    import rasterio
    from rasterio.io import MemoryFile

    with MemoryFile() as memory:
        profile: dict[str, Any] = {"driver": "GTiff", "width": side, "height": side, "count": 1, "dtype": "float32"}
        tiles = {"tiled": True, "blockxsize": 4096, "blockysize": 4096, "SPARSE_OK": True}
        with memory.open(**profile, **tiles, transform=rasterio.Affine(2, 0, 1, 0, -2, 0)):
            pass
        return bytes(memory.read())


def meshes() -> dict[str, tuple[str, bytes]]:
    vtu = b'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY a "aaaaaaaaaa">' + b"".join(
        b'<!ENTITY a%d "%s">' % (level, b"&a%d;" % (level - 1) * 10 if level > 1 else b"&a;" * 10)
        for level in range(1, 12)
    )
    return {
        "a billion laughs": ("mesh.vtu", vtu + b"]><VTKFile>&a11;</VTKFile>"),
        "a bomb": ("mesh.vtu", bomb_vtu()),
        "10^12 vertices": (
            "mesh.ply",
            b"ply\nformat binary_little_endian 1.0\nelement vertex 1000000000000\nproperty float x\nend_header\n",
        ),
        "10^12 points": (
            "mesh.vtk",
            b"# vtk DataFile Version 3.0\na\nBINARY\nDATASET UNSTRUCTURED_GRID\nPOINTS 1000000000000 double\n",
        ),
        "2^32 triangles": ("mesh.stl", bytes(80) + b"\xff\xff\xff\xff" + bytes(50)),
        "corners that are not there": ("mesh.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\nf 1 2 -5\n"),
        "vertices at 1e300": (
            "mesh.obj",
            b"v 0 0 0\nv 1e300 0 0\nv 0 1e300 0\nv 0 0 1e300\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n",
        ),
        "a format that names files": ("mesh.xdmf", b"<Xdmf><Domain/></Xdmf>"),
        "nothing": ("mesh.stl", b""),
    }


def bomb_vtu() -> bytes:
    """A file of some KB of which a block swells to 2 GiB."""
    import base64

    packer = zlib.compressobj(9)
    head = packer.compress(bytes(2**24)) + packer.flush(zlib.Z_FULL_FLUSH)
    # What follows a full flush stands for itself: it can be repeated.
    block = head + 127 * (packer.compress(bytes(2**24)) + packer.flush(zlib.Z_FULL_FLUSH))
    sizes = struct.pack("<4I", 1, 2**31 - 1, 0, len(block))
    data = base64.b64encode(sizes) + base64.b64encode(block)
    return (
        b'<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian" compressor="vtkZLibDataCompressor">'
        b'<UnstructuredGrid><Piece NumberOfPoints="4" NumberOfCells="1"><Points><DataArray type="Float64" '
        b'NumberOfComponents="3" format="binary">'
        + data
        + b"</DataArray></Points></Piece></UnstructuredGrid></VTKFile>"
    )


def tables() -> dict[str, tuple[str, bytes]]:
    name = "profile.csv"
    return {
        "a field of a megabyte": (name, b"x,height\n" + b"1" * 2**20 + b",2\n"),
        "a quotation that nothing closes": (name, b'x,height\n"1,2\n3,4\n'),
        "zeros": (name, b"x,height\n\0\0,1\n2,3\n"),
        "1e300": (name, b"x,height\n0,1e300\n1e300,1\n"),
        "infinity": (name, b"x,height\n0,inf\n1,1\n"),
        "no text": (name, b"\xff\xfe\xff"),
        "nothing": (name, b""),
        "a header twice": (name, b"x,height,x\n1,2,3\n4,5,6\n"),
    }


def states() -> dict[str, tuple[str, bytes]]:
    base, name = seeds.state(), "checkpoint.npz"

    def with_array(**changes: np.ndarray) -> tuple[str, bytes]:
        return name, mutations.npz({**base, **changes})

    state = base["state"].copy()
    state[0, 0, 0] = 1e9
    order = base["order"].copy()
    order[0] = 10**6
    run = json.loads(str(base["run"]))
    return {
        "particles outside": with_array(state=state),
        "nan": with_array(state=np.full_like(state, np.nan)),
        "an order beyond the particles": with_array(order=order),
        "a particle twice": with_array(order=np.zeros_like(order)),
        "positions that are a number": with_array(positions=np.array(1.0)),
        "no energies": with_array(energy=base["energy"][:0]),
        "a frame of -1": with_array(run=np.array(json.dumps(run | {"frame": -1}))),
        "a frame of 10^30": with_array(run=np.array(json.dumps(run | {"frame": 10**30}))),
        "a precision of f16": with_array(features=np.array(str(base["features"]).replace("f32", "f16"))),
        "a recording of 0 frames": with_array(recording=np.array(str(base["recording"]).replace('"all"', "0"))),
    }
