"""Wavefront OBJ: vertices and polygons, whose corners may name texture and normals and count from the end."""

import codecs
from pathlib import Path

import numpy as np

from datasets.errors import require
from datasets.geometry.ground import Floats, Integers


def read_obj(path: Path) -> tuple[Floats, Integers]:
    """Vertices [V, 3], and the polygons end to end: the number of corners of each, then these, counted from 0.

    Raises InputError for corners that are no vertices, ValueError for what is no number.
    """
    content = path.read_bytes()
    encoding = "utf-16" if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig"
    text = content.decode(encoding, errors="replace").replace("\\\r\n", " ").replace("\\\n", " ")
    vertices, polygons = list[list[float]](), list[list[int]]()
    for line in text.splitlines():
        kind, *words = line.split("#", 1)[0].split() or [""]
        if kind == "v":
            vertices.append([float(word) for word in words[:3]])
        elif kind == "f":
            corners = [int(word.split("/", 1)[0]) for word in words]
            polygons.append([corner - 1 if corner > 0 else len(vertices) + corner for corner in corners])
    require(bool(polygons), "", "a mesh with faces", "none")
    there = all(len(corners) >= 3 and 0 <= min(corners) <= max(corners) < len(vertices) for corners in polygons)
    require(there, "", f"faces of three or more of the {len(vertices)} vertices", "others")
    return np.array(vertices), np.array([number for corners in polygons for number in (len(corners), *corners)])
