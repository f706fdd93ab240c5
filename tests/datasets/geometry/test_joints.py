"""Solids that meet in less than a face in 3D, an edge in 2D: sand passes there, so they are refused."""

import math

import manifold3d
import numpy as np
import pytest

from datasets.geometry.nearest import nearest
from datasets.scene import Solid
from tests.datasets.geometry.solids import as_rows, scene_of, surface
from tests.refusals import refused

PLANE, SPACE = (2.0, 1.0), (2.0, 1.0, 1.0)
TIP = (0.5037, 0.1561)


def plate(angle_deg: float, side: float, tip: tuple[float, float] = TIP) -> list[tuple[float, float]]:
    """Corners of a plate of 0.25 m x 5 mm that rises from `tip`, on one side of a line at this angle."""
    angle = math.radians(angle_deg)
    along = 0.25 * np.array((math.cos(angle), math.sin(angle)))
    across = 0.02 * side * np.array((-along[1], along[0]))
    corners = np.array(tip) + np.stack([0.0 * along, along, along + across, across])
    return [(float(x), float(y)) for x, y in corners]


def deep(corners: list[tuple[float, float]]) -> Solid:
    """The same in 3D, from z = 0 to 1 m."""
    # The library turns a section that runs clockwise.
    section = manifold3d.CrossSection([corners], manifold3d.FillRule.NonZero)
    mesh = manifold3d.Manifold.extrude(section, 1.0).to_mesh64()
    vertices, triangles = np.array(mesh.vert_properties)[:, :3], np.array(mesh.tri_verts, np.int64)
    return Solid(kind="mesh", vertices=as_rows(vertices), triangles=as_rows(triangles))


def cube(x: float, y: float, z: float) -> Solid:
    """Of 0.1 m."""
    return Solid(lower=(x, y, z), size=(0.1, 0.1, 0.1))


FIRST = cube(0.5, 0.0, 0.5)


@pytest.mark.parametrize("gap", [0.0, 1e-6, 1e-5, 3e-4])
@pytest.mark.parametrize(("first", "second"), [(60.0, 120.0), (0.0, 90.0), (30.0, 150.0)])
def test_plates_that_meet_in_a_point_are_refused(first: float, second: float, gap: float) -> None:
    """Sand leaks through such a point, unless a third solid closes it.

    Rounded vertices leave gaps of up to a fiftieth of a cell, here of 20 mm; wider ones are meant.
    """

    def plates(apart: float) -> tuple[Solid, ...]:
        corners = plate(first, -1.0, (TIP[0] + apart, TIP[1])), plate(second, 1.0)
        return tuple(Solid(kind="polygon", vertices=tuple(outline)) for outline in corners)

    said = "solids[1]: expected solids that overlap or share an edge, got one that meets solids[0] in a point"
    refused(lambda: surface(scene_of(*plates(gap), size=PLANE)), said=said + (" but for" if gap else ""))
    lid = Solid(lower=(0.49, 0.14), size=(0.03, 0.03))
    closed = surface(scene_of(*plates(gap), lid, size=PLANE))
    assert (nearest(closed, np.array([TIP])).distance < 0.0).all()
    assert surface(scene_of(*plates(1.0e-3), size=PLANE)).dimension == 2


@pytest.mark.parametrize("overhang", [0.0, 1e-7, 1e-6, 1e-4, -1e-6])
def test_a_post_on_the_end_of_a_plate_is_not_refused(overhang: float) -> None:
    """They share an edge of 20 mm but for the overhang, whose two corners are no meeting in a point."""
    foot = Solid(lower=(0.5, 0.2), size=(0.2 - overhang, 0.005))
    assert surface(scene_of(foot, Solid(lower=(0.68, 0.205), size=(0.02, 0.3)), size=PLANE)).dimension == 2


@pytest.mark.parametrize("gap", [1e-6, 3e-4])
def test_faces_that_nearly_meet_are_not_refused(gap: float) -> None:
    """Sand passes no slit so much narrower than a cell."""
    first, second = (Solid(lower=(x, 0.2), size=(0.3, 0.02)) for x in (0.2, 0.5 + gap))
    assert surface(scene_of(first, second, size=PLANE)).dimension == 2
    assert surface(scene_of(FIRST, cube(0.6 + gap, 0.0, 0.5), size=SPACE)).dimension == 3
    assert surface(scene_of(FIRST, cube(0.6 + 2e-3, 0.0, 0.6), size=SPACE)).dimension == 3


@pytest.mark.parametrize(
    ("second", "said"),
    [
        (cube(0.6, 0.0, 0.6), "along a line"),
        (cube(0.6, 0.1, 0.5), "along a line"),
        (cube(0.6, 0.1, 0.6), "in a point"),
        (cube(0.4, 0.1, 0.4), "in a point"),
        (cube(0.6 + 1.0e-4, 0.1, 0.6), "in a point but for"),
    ],
)
def test_less_than_a_common_face_is_refused(second: Solid, said: str) -> None:
    words = f"solids[1]: expected solids that overlap or share a face, got one that meets solids[0] {said}"
    refused(lambda: surface(scene_of(FIRST, second, size=SPACE)), said=words)


@pytest.mark.parametrize("gap", [0.0, 1.0e-4])
@pytest.mark.parametrize(("first", "second"), [(60.0, 120.0), (0.0, 90.0), (20.0, 160.0)])
def test_plates_that_share_an_edge_alone_are_refused_in_3d(first: float, second: float, gap: float) -> None:
    """31 of 2800 particles went through; plates that overlap by a fifth of their thickness are one."""
    left, right = deep(plate(first, -1.0, (TIP[0] + gap, TIP[1]))), deep(plate(second, 1.0))
    said = "solids[1]: expected solids that overlap or share a face, got one that meets solids[0] along a line"
    refused(lambda: surface(scene_of(left, right, size=SPACE)), said=said + (" but for" if gap else ""))
    closed = deep(plate(second, 1.0, (TIP[0] - 0.001, TIP[1])))
    assert surface(scene_of(left, closed, size=SPACE)).dimension == 3


@pytest.mark.parametrize(
    "others",
    [
        (cube(0.6, 0.0, 0.5),),
        (cube(0.5, 0.1, 0.5),),
        (cube(0.6, 0.05, 0.55),),
        (cube(0.6 + 1.0e-9, 0.0, 0.5),),
        (cube(0.65, 0.0, 0.65),),
        (cube(0.6, 0.0, 0.6), cube(0.6, 0.0, 0.5)),
        (Solid(lower=(0.6, 0.0, 0.5), size=(0.1, 0.002, 0.1)),),
    ],
    ids=["side", "top", "a part of a face", "but for rounding", "apart", "closed by a third", "a thin plate"],
)
def test_solids_that_share_a_face_or_nothing_are_not(others: tuple[Solid, ...]) -> None:
    assert set(surface(scene_of(FIRST, *others, size=SPACE)).solid.tolist()) == set(range(1 + len(others)))
