"""How a trajectory falls on an image: the part of the box that the flow needs, in parallel projection."""

from dataclasses import dataclass

import numpy as np
import pyvista
from numpy.typing import NDArray

from datasets.scene import Baffle, Mass
from datasets.trajectory import Trajectory

Place = NDArray[np.floating]

EYE = {2: (0.0, 0.0, 1.0), 3: (0.45, 0.55, 1.0)}
"""From the flow to the eye, per dimension: in 3D it runs to the right and a little nearer, seen from above."""
LEFT, RIGHT, BOTTOM, TOP = 115, 260, 105, 80
"""Margins of an image [px], where the scales, the colour bar and the time stand."""
WIDEST, HIGHEST = 1600, 1200
"""An image is at most this large [px], with its margins."""


@dataclass(frozen=True, kw_only=True)
class View:
    """Parallel projection of a part of the box onto an image: lengths are the same near and far."""

    lower: Place
    """Lower corner of the part [m], shape [3]."""
    upper: Place
    """Its upper corner [m], shape [3]; in 2D as deep as the lower one."""
    eye: Place
    """Unit vector from the flow to the eye, shape [3]."""

    @staticmethod
    def of(trajectory: Trajectory) -> "View":
        """All that the flow ever reaches, the baffles, and the walls that are near."""
        lower, upper = extent(trajectory)
        eye = np.array(EYE[trajectory.scene.dimension])
        return View(lower=lower, upper=upper, eye=eye / np.linalg.norm(eye))

    @property
    def axes(self) -> Place:
        """Unit vectors to the right and upwards in the image, shape [2, 3]."""
        right = np.cross((0.0, 1.0, 0.0), self.eye)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(self.eye, right)])

    @property
    def _shadow(self) -> tuple[Place, Place]:
        """Lower left corner and size of the part in the plane of the image [m], shape [2] each."""
        corners = np.stack(np.meshgrid(*zip(self.lower, self.upper, strict=True)), axis=-1).reshape(-1, 3)
        projected = corners @ self.axes.T
        return projected.min(axis=0), np.ptp(projected, axis=0)

    @property
    def scale(self) -> float:
        """Pixels per metre."""
        width, height = self._shadow[1]
        return float(min((WIDEST - LEFT - RIGHT) / width, (HIGHEST - BOTTOM - TOP) / height))

    @property
    def reach(self) -> float:
        """Diagonal of the part [m]."""
        return float(np.linalg.norm(self.upper - self.lower))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the image [px]; even numbers, as the encoders of movies want them."""
        width, height = self._shadow[1] * self.scale
        return 2 * round((LEFT + RIGHT + width) / 2), 2 * round((BOTTOM + TOP + height) / 2)

    def pixel(self, place: Place) -> Place:
        """Where a place [m], shape [3], is in the image [px], shape [2], from its lower left corner."""
        return np.asarray((self.axes @ place - self._shadow[0]) * self.scale + (LEFT, BOTTOM))

    def place(self, pixel: tuple[float, float], depth: float) -> Place:
        """The place [m], shape [3], at a pixel of the image, `depth` [m] nearer to the eye than the flow's middle."""
        across = (np.array(pixel) - (LEFT, BOTTOM)) / self.scale + self._shadow[0]
        return np.asarray(across @ self.axes + (0.5 * (self.lower + self.upper) @ self.eye + depth) * self.eye)

    def aim(self, camera: pyvista.Camera) -> None:
        """Make the camera see this view."""
        width, height = self.size
        focus, far = self.place((0.5 * width, 0.5 * height), 0.0), 2.0 * self.reach
        camera.focal_point = tuple(focus)
        camera.position = tuple(focus + far * self.eye)
        camera.up = (0.0, 1.0, 0.0)
        camera.parallel_projection = True
        camera.parallel_scale = 0.5 * height / self.scale
        camera.clipping_range = (0.25 * far, 1.75 * far)


def extent(trajectory: Trajectory) -> tuple[Place, Place]:
    """Corners [m], shape [3] each, of what there is to see, with some air; up to the walls where these are near.

    That is the flow, the masses, the baffles and the solids but for terrain, which is everywhere.
    """
    scene, positions = trajectory.scene, trajectory.positions
    size = np.array(scene.domain.size)
    boxes: list[Mass | Baffle] = [*scene.masses, *scene.baffles]
    corners = [np.array(each.lower) for each in boxes] + [np.add(each.lower, each.size) for each in boxes]
    for solid in scene.solids:
        if solid.lower is not None and solid.size is not None:
            corners += [np.array(solid.lower), np.add(solid.lower, solid.size)]
        corners += [np.array(vertex) for vertex in solid.vertices or ()]
    lower, upper = np.min(corners, axis=0).clip(0.0, size), np.max(corners, axis=0).clip(0.0, size)
    # These pass over points that a failed simulation has lost (NaN).
    lower = np.fmin(lower, np.fmin.reduce(positions, axis=(0, 1)).clip(0.0, size))
    upper = np.fmax(upper, np.fmax.reduce(positions, axis=(0, 1)).clip(0.0, size))
    air = 0.06 * float(np.max(upper - lower))
    lower[1] = 0.0
    lower = np.where(lower < 3.0 * air, 0.0, lower - air)
    upper = np.where(upper > size - 3.0 * air, size, upper + air)
    return np.pad(lower, (0, 3 - len(lower))), np.pad(upper, (0, 3 - len(upper)))
