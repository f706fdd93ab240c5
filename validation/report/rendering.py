"""Pictures and movies of a trajectory, drawn off-screen: its points coloured by a field, the baffles, the time."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import cast

import av
import numpy as np
import pyvista
from matplotlib import colormaps
from matplotlib.colors import ListedColormap
from matplotlib.image import imsave
from numpy.typing import NDArray
from tqdm import tqdm

from datasets.command_line import WorkFailed
from datasets.errors import InputError
from datasets.exchange.vtk import Meshes, box, spatial
from datasets.files import replacing
from datasets.geometry.margins import Box
from datasets.geometry.planar import ring_of
from datasets.geometry.surface import solids_of
from datasets.maps.plan import volumes_of
from datasets.trajectory import Trajectory
from validation.report.stage import INK, Stage, scale_marks
from validation.report.view import View

Image = NDArray[np.uint8]
ColourBar = tuple[NDArray[np.float64], tuple[float, float], dict[float, str]]
"""Colours, shape [K, 3]; the values that its ends stand for; what is written at which share of its height."""


class Colour(StrEnum):
    """What the colour of a point tells."""

    VELOCITY = "velocity"
    DISPLACEMENT = "displacement"
    PRESSURE = "pressure"
    PLASTIC_STRAIN = "plastic_strain"
    MATERIAL = "material"


@dataclass(frozen=True, kw_only=True)
class Field:
    """How a field becomes colours."""

    title: str
    """Name and unit at the colour bar."""
    unit: float = 1.0
    """One of that unit in SI units."""
    colours: str
    """Colour map of matplotlib."""


FIELDS = {
    Colour.VELOCITY: Field(title="speed [m/s]", colours="viridis"),
    Colour.DISPLACEMENT: Field(title="displacement [m]", colours="viridis"),
    Colour.PRESSURE: Field(title="pressure [kPa]", unit=1000.0, colours="plasma"),
    Colour.PLASTIC_STRAIN: Field(title="plastic strain [-]", colours="inferno"),
    Colour.MATERIAL: Field(title="material", colours="Set2"),
}
RANGE_QUANTILE, RANGE_FRAMES = 0.995, 40
"""A colour bar ends near this quantile of the points of so many frames: no single point decides."""
POINT_SIZE = 1.25
"""Diameter of a drawn point over the distance between points at the start."""
STEEL, GROUND, FAINT = "#8d9aa8", "#b5aa98", "#77736a"
"""Colours of the baffles, of other solids and of the masses' outlines."""
ENCODERS = (("libx264", ".mp4", "yuv420p"), ("mpeg4", ".mp4", "yuv420p"), ("gif", ".gif", "rgb8"))
"""Codec, ending of the file and pixels of a movie; the first that is there is taken."""


def require(trajectory: Trajectory, colour: Colour) -> None:
    """Raise InputError where `trajectory` has not recorded what `colour` is to show."""
    missing = colour in (Colour.PRESSURE, Colour.PLASTIC_STRAIN) and getattr(trajectory, colour) is None
    if missing or (colour is Colour.VELOCITY and Meshes(trajectory).velocity(0) is None):
        raise InputError("expected a trajectory that recorded it, this one did not", key=colour)


class Picture:
    """A trajectory on its stage; only the points and the time change with the frames. A context.

    sampling: pixels drawn per pixel of the image, along each axis; more is smoother and slower.
    Raises InputError for a colour that was not recorded, WorkFailed where nothing can be drawn.
    """

    def __init__(self, trajectory: Trajectory, colour: Colour, *, sampling: int = 1) -> None:
        require(trajectory, colour)
        self.trajectory, self.meshes, self.colour = trajectory, Meshes(trajectory), colour
        self.stage = Stage(View.of(trajectory), sampling=sampling)
        self.stage.draw_panes(trajectory.scene)
        self._draw_boxes()
        self._draw_points()
        self.clock = self.stage.write_above("")

    def __enter__(self) -> "Picture":
        return self

    def __exit__(self, *_: object) -> None:
        self.stage.plotter.close()

    def at(self, frame: int) -> Image:
        """The image at `frame`, shape [height, width, 3]."""
        self.cloud.points = spatial(self.trajectory.positions[frame])
        self.cloud.point_data["colour"] = self.values(frame)
        # The box is drawn level on a slope, too.
        slope = self.trajectory.scene.slope_deg
        self.clock.input = f"t = {self.trajectory.time[frame]:.3f} s" + (f"   slope {slope:g}°" if slope else "")
        return self.stage.image()

    def values(self, frame: int) -> NDArray[np.floating]:
        """What the colours show at `frame`, in the unit of the colour bar, shape [N]."""
        values = self.meshes.fields(frame)[self.colour]
        if values.ndim == 2:
            values = np.linalg.norm(values, axis=1)
        return np.asarray(values / FIELDS[self.colour].unit)

    @property
    def spacing(self) -> float:
        """Distance between neighbouring points at the start [m]."""
        return float(np.mean(volumes_of(self.trajectory)) ** (1.0 / self.trajectory.scene.dimension))

    def _draw_boxes(self) -> None:
        """The baffles and other solids, and the outlines of the masses that were boxes at the start."""
        for mass in [mass for mass in self.trajectory.scene.masses if mass.kind == "box"]:
            self.stage.draw_lines(box(mass.lower, mass.size).extract_all_edges(), FAINT)
        if self.trajectory.scene.baffles:
            baffles = self.meshes.part("baffles", 0, 0)
            self.stage.plotter.add_mesh(baffles, color=STEEL, ambient=0.25)
            self.stage.draw_lines(baffles.extract_all_edges(), INK)
        if "solids" in self.meshes.parts:
            self._draw_solids()

    def _draw_solids(self) -> None:
        """The other solids, as far as the view goes: in 3D their free surface, in 2D their areas too."""
        if self.trajectory.scene.dimension == 3:
            self.stage.plotter.add_mesh(self._seen(self.meshes.solid_surface), color=GROUND, ambient=0.25)
            return
        for area in self._areas():
            self.stage.plotter.add_mesh(self._seen(area), color=GROUND, lighting=False)
        self.stage.draw_lines(self._seen(self.meshes.solid_surface), INK)

    def _areas(self) -> list[pyvista.PolyData]:
        """The areas of the other solids in 2D, behind the points."""
        scene = self.trajectory.scene
        solids, keys = solids_of(scene)
        box_of_scene = Box(scene.domain.size, scene.domain.cell)
        areas = []
        for solid, key in list(zip(solids, keys, strict=True))[len(scene.baffles) :]:
            points = spatial(ring_of(solid, key, box_of_scene).points)
            # Before the pane that is behind all, behind the points.
            points[:, 2] = 0.01 * self.spacing
            areas.append(pyvista.PolyData(points, [len(points), *range(len(points))]).triangulate())
        return areas

    def _seen(self, mesh: pyvista.PolyData) -> pyvista.PolyData:
        """The part of a surface that the view holds, of any depth in 2D."""
        low, high = self.stage.view.lower.copy(), self.stage.view.upper.copy()
        if self.trajectory.scene.dimension == 2:
            low[2], high[2] = -1.0, 1.0
        clipped = mesh.clip_box(np.stack([low, high], axis=1).ravel().tolist(), invert=False)
        return clipped.extract_surface(algorithm=None)

    def _draw_points(self) -> None:
        """The points, which `at` moves and colours, and the colour bar."""
        colours, limits, marks = self._materials() if self.colour is Colour.MATERIAL else self._range()
        self.cloud = pyvista.PolyData(spatial(self.trajectory.positions[0]))
        self.cloud.point_data["colour"] = self.values(0)
        size = max(2.0, POINT_SIZE * self.spacing * self.stage.view.scale)
        self.stage.plotter.add_mesh(
            self.cloud,
            scalars="colour",
            clim=limits,
            cmap=ListedColormap(colours),
            show_scalar_bar=False,
            style="points",
            render_points_as_spheres=True,
            point_size=size * self.stage.sampling,
            # Shaded, but not so much that the colours could not be read.
            ambient=0.35,
            diffuse=0.75,
        )
        if self.trajectory.scene.dimension == 3:
            # Shadows in the corners show the shape of the flow; the bias keeps them off the flat panes.
            self.stage.plotter.enable_ssao(radius=4.0 * self.spacing, bias=0.8 * self.spacing, kernel_size=64)
        self.stage.draw_colour_bar(FIELDS[self.colour].title, colours, marks)

    def _range(self) -> ColourBar:
        last = len(self.trajectory.time) - 1
        frames = np.unique(np.linspace(0, last, RANGE_FRAMES).round().astype(int))
        values = np.array([self.values(frame) for frame in frames])
        known = values[np.isfinite(values)]
        top = float(np.quantile(known, RANGE_QUANTILE)) if len(known) else 0.0
        ticks = scale_marks(0.0, top if top > 0.0 else 1.0, 5)
        colours = colormaps[FIELDS[self.colour].colours](np.linspace(0.0, 1.0, 256))[:, :3]
        return colours, (0.0, ticks[-1]), {tick / ticks[-1]: f"{tick:g}" for tick in ticks}

    def _materials(self) -> ColourBar:
        materials = self.meshes.materials
        colours = colormaps[FIELDS[self.colour].colours](np.arange(len(materials)) % 8)[:, :3]
        names = [f"{index}: φ {material.friction_deg:g}°" for index, material in enumerate(materials)]
        marks = {(index + 0.5) / len(materials): name for index, name in enumerate(names)}
        return colours, (-0.5, len(materials) - 0.5), marks


def write_picture(path: Path, trajectory: Trajectory, colour: Colour, frame: int) -> None:
    """Draw `frame` into a PNG. Raises InputError and WorkFailed."""
    with Picture(trajectory, colour, sampling=2) as picture:
        image = picture.at(frame)
    with replacing(path) as part:
        imsave(part, image)


def write_movie(
    path: Path, trajectory: Trajectory, colour: Colour, frames: Sequence[int], *, rate: int, progress: bool = False
) -> Path:
    """Draw `frames` into a movie of `rate` frames a second, and return its path.

    An MP4, or a GIF where there is no encoder for it: the ending of `path` follows. Raises InputError and WorkFailed.
    """
    codec, ending, pixels = _encoder()
    path = path.with_suffix(ending)
    with Picture(trajectory, colour) as picture, replacing(path) as part, av.open(str(part), "w") as file:
        stream = cast(av.VideoStream, file.add_stream(codec, rate=rate))
        stream.width, stream.height = picture.stage.view.size
        stream.pix_fmt = pixels
        for frame in tqdm(frames, desc="movie", unit="frame", disable=not progress):
            file.mux(stream.encode(av.VideoFrame.from_ndarray(picture.at(frame), format="rgb24")))
        file.mux(stream.encode())
    return path


def _encoder() -> tuple[str, str, str]:
    for encoder in ENCODERS:
        try:
            av.Codec(encoder[0], "w")
        except ValueError:
            continue
        return encoder
    raise WorkFailed("expected an encoder of movies in PyAV, found none")
