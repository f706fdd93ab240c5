"""Pictures and movies of a trajectory by pyvista, off-screen: particles coloured by a field, the solids, the time."""

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyvista
from matplotlib import colormaps
from matplotlib.colors import ListedColormap
from matplotlib.image import imsave
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from tqdm import tqdm

from datasets.errors import InputError, WorkFailed
from datasets.exchange.vtk import Meshes, edges, extent, spatial
from datasets.files import replacing
from datasets.flow.fields import RANGE_QUANTILE, SCALES, Colour, FlowFields
from datasets.flow.trajectory import Trajectory
from datasets.geometry.surface import body_of, solids_of

Image = NDArray[np.uint8]
Floats = NDArray[np.floating]


RANGE_FRAMES = 40
"""Of so many frames the `RANGE_QUANTILE` is where a colour bar ends."""
DIAMETER = 1.25
"""Of a drawn particle over the distance between particles at the start."""
INK, STEEL, GROUND, FAINT = "#262626", "#8d9aa8", "#b5aa98", "#77736a"
"""Colours of the letters, of the baffles, of other solids and of the masses' outlines."""
EYE = {2: (0.0, 0.0, 1.0), 3: (0.45, 0.55, 1.0)}
"""From the flow to the eye, per dimension: in 3D it runs to the right and a little nearer, seen from above."""
WIDTH, HEIGHT = 1600, 1200
"""An image is at most this large [px]."""
MARGIN = (0.13, 0.24)
"""Share of the image's width and height beside the flow, for scales, colour bar and time."""
BAR = {"vertical": True, "position_x": 0.91, "position_y": 0.2, "height": 0.55, "width": 0.05, "fmt": "%g"}
LETTERS = {"color": INK, "title_font_size": 20, "label_font_size": 20}


def require_recorded(trajectory: Trajectory, colour: Colour) -> None:
    """Raise InputError where `trajectory` has not recorded what `colour` is to show."""
    missing = colour in (Colour.PRESSURE, Colour.PLASTIC_STRAIN) and getattr(trajectory, colour) is None
    if missing or (colour is Colour.VELOCITY and FlowFields(trajectory).velocity(0) is None):
        raise InputError("expected a trajectory that recorded it, this one did not", key=colour)


class Picture:
    """A trajectory in a window off-screen; only the particles and the time change with the frames. A context.

    smooth: with anti-aliasing, which takes longer. Raises InputError for a colour that was not recorded, WorkFailed
    where nothing can be drawn.
    """

    def __init__(self, trajectory: Trajectory, colour: Colour, *, smooth: bool = False) -> None:
        require_recorded(trajectory, colour)
        self.trajectory, self.meshes, self.colour = trajectory, Meshes(trajectory), colour
        lower, upper = extent(trajectory.scene, trajectory.positions)
        marks = _marks(float(np.max(upper - lower)), 10)
        self.step = float(marks[1] - marks[0])
        """Distance between two numbers of a scale [m]."""
        self.lower = self.step * np.floor(lower / self.step + 1e-6)
        self.upper = self.step * np.ceil(upper / self.step - 1e-6)
        eye = np.array(EYE[trajectory.scene.dimension]) / np.linalg.norm(EYE[trajectory.scene.dimension])
        right = np.cross((0.0, 1.0, 0.0), eye) / np.linalg.norm(np.cross((0.0, 1.0, 0.0), eye))
        corners = np.array([*product(*zip(self.lower, self.upper, strict=True))])
        size = np.ptp(corners @ np.stack([right, np.cross(eye, right)]).T, axis=0)
        free = np.array([1.0 - 2.0 * MARGIN[0], 1.0 - MARGIN[1]])
        self.scale = float(np.min((WIDTH, HEIGHT) * free / size))
        """Pixels per metre."""
        width, height = (2 * np.round(size * self.scale / free / 2)).astype(int).tolist()
        self.plotter = _window(max(width, WIDTH // 2), max(height, HEIGHT // 3))
        self._look(eye, right)
        if smooth:
            self.plotter.enable_anti_aliasing("ssaa")
        self._draw_solids()
        self._draw_particles()
        self._draw_scales()

    def __enter__(self) -> "Picture":
        return self

    def __exit__(self, *_: object) -> None:
        self.plotter.close()

    def at(self, frame: int) -> Image:
        """The image at `frame`, shape [height, width, 3]."""
        self.cloud.points = spatial(self.trajectory.positions[frame])
        self.cloud.point_data["colour"] = self.values(frame)
        # The box is drawn level on a slope, too.
        slope = self.trajectory.scene.slope_deg
        time = f"t = {self.trajectory.time[frame]:.3f} s" + (f"   slope {slope:g}°" if slope else "")
        self.plotter.add_text(time, position=(0.03, 0.93), viewport=True, font_size=12, color=INK, name="time")
        return np.asarray(self.plotter.screenshot(return_img=True), np.uint8)

    def values(self, frame: int) -> Floats:
        """What the colours show at `frame`, in the unit of the colour bar, shape [N]."""
        return SCALES[self.colour].scaled(self.meshes.fields.at_frame(frame)[self.colour])

    def _look(self, eye: Floats, right: Floats) -> None:
        """Parallel projection along `eye`, the flow a little left of the middle, where the colour bar is."""
        camera, depth = self.plotter.camera, 2.0 * float(np.linalg.norm(self.upper - self.lower))
        height = self.plotter.window_size[1] / self.scale
        width = self.plotter.window_size[0] / self.scale
        focus = 0.5 * (self.lower + self.upper) + 0.03 * width * right - 0.02 * height * np.cross(eye, right)
        camera.focal_point, camera.position, camera.up = tuple(focus), tuple(focus + depth * eye), (0.0, 1.0, 0.0)
        camera.parallel_projection, camera.parallel_scale = True, 0.5 * height
        camera.clipping_range = (0.1 * depth, 2.0 * depth)

    def _lines(self, mesh: Any, colour: str) -> None:
        self.plotter.add_mesh(mesh, color=colour, line_width=1.5, lighting=False)

    def _draw_solids(self) -> None:
        """Baffles, other solids and the outlines of the masses that were boxes at the start."""
        scene = self.trajectory.scene
        for mass in [mass for mass in scene.masses if mass.kind == "box"]:
            self._lines(edges(mass.lower, mass.size), FAINT)
        if not (scene.baffles or scene.solids):
            return
        surface, count = self.meshes.part("solids", 0, 0), len(scene.baffles)
        if scene.dimension == 3:
            for chosen, colour in ((surface["solid"] < count, STEEL), (surface["solid"] >= count, GROUND)):
                if chosen.any():
                    part = self._clipped(
                        surface.extract_cells(np.flatnonzero(chosen).tolist()).extract_surface(algorithm=None)
                    )
                    self.plotter.add_mesh(part, color=colour, ambient=0.25)
                    if colour is STEEL:
                        self._lines(part.clean().extract_feature_edges(), INK)
            return
        for number, (solid, key) in enumerate(zip(*solids_of(scene), strict=True)):
            ring = spatial(body_of(solid, key, scene.domain).vertices)
            area = pyvista.PolyData(ring, [len(ring), *range(len(ring))]).triangulate()
            self.plotter.add_mesh(self._clipped(area), color=STEEL if number < count else GROUND, lighting=False)
        self._lines(self._clipped(surface), INK)

    def _clipped(self, mesh: pyvista.PolyData) -> pyvista.PolyData:
        """The part of a surface within the picture, of any depth in 2D."""
        low, high = self.lower.copy(), self.upper.copy()
        if self.trajectory.scene.dimension == 2:
            low[2], high[2] = -1.0, 1.0
        clipped = mesh.clip_box(np.stack([low, high], axis=1).ravel().tolist(), invert=False)
        return clipped.extract_surface(algorithm=None)

    def _draw_particles(self) -> None:
        """The particles, which `at` moves and colours, and the colour bar."""
        self.cloud = pyvista.PolyData(spatial(self.trajectory.positions[0]))
        self.cloud.point_data["colour"] = self.values(0)
        field, named = SCALES[self.colour], self.colour is Colour.MATERIAL
        if named:
            materials = self.meshes.fields.materials
            limits: tuple[float, float] = (-0.5, len(materials) - 0.5)
            colours: Any = ListedColormap(colormaps[field.colours](np.arange(len(materials)) % 8)[:, :3])
            names = {float(index): f"{index}: {each.friction_deg:g}°" for index, each in enumerate(materials)}
        else:
            marks = _marks(self._largest(), 5)
            limits, colours, names = (0.0, float(marks[-1])), field.colours, None
        self.plotter.add_mesh(
            self.cloud,
            scalars="colour",
            clim=limits,
            cmap=colours,
            annotations=names,
            style="points",
            render_points_as_spheres=True,
            point_size=max(2.0, DIAMETER * self.meshes.fields.spacing * self.scale),
            # Shaded, but not so much that the colours could not be read.
            ambient=0.35,
            diffuse=0.75,
            scalar_bar_args={"title": field.title, "n_labels": 0 if named else len(marks), **BAR, **LETTERS},
        )

    def _largest(self) -> float:
        frames = np.unique(np.linspace(0, len(self.trajectory.time) - 1, RANGE_FRAMES).round().astype(int))
        values = np.array([self.values(frame) for frame in frames])
        known = values[np.isfinite(values)]
        top = float(np.quantile(known, RANGE_QUANTILE)) if len(known) else 0.0
        return top if top > 0.0 else 1.0

    def _draw_scales(self) -> None:
        """A grid behind the flow and scales [m] along its edges."""
        flat, step = self.trajectory.scene.dimension == 2, self.step
        lower, upper = self.lower.copy(), self.upper.copy()
        if flat:
            lower[2] = upper[2] = -self.meshes.fields.spacing
        counts = np.rint((upper - lower) / step).astype(int) + 1
        self.plotter.show_bounds(
            bounds=np.stack([lower, upper], axis=1).ravel().tolist(),
            grid="front" if flat else "back",
            location="outer",
            ticks="outside",
            show_zaxis=not flat,
            xtitle="x [m]",
            ytitle="y [m]",
            ztitle="z [m]",
            fmt=f"%.{max(0, -int(np.floor(np.log10(step) + 1e-9)))}f",
            color=INK,
            font_size=20,
            bold=False,
            use_2d=flat,
            **dict(zip(("n_xlabels", "n_ylabels", "n_zlabels"), counts, strict=True)),
        )


def _marks(upper: float, count: int) -> Floats:
    """About `count` round numbers, as far apart, from 0 to `upper` or behind."""
    return np.asarray(MaxNLocator(count, steps=(1, 2, 5, 10)).tick_values(0.0, upper))


def _window(width: int, height: int) -> Any:
    """A window of pyvista off-screen of even size; untyped, because the decorators of its methods hide their types."""
    # What VTK tries before it finds a way to draw without a screen is of no interest.
    with pyvista.vtk_verbosity("off"):
        plotter: Any = pyvista.Plotter(off_screen=True, window_size=[width, height])
        window = plotter.render_window
        window.Initialize()
        # Without this VTK would draw into nothing and take the process with it.
        if not window.IsCurrent():
            plotter.close()
            raise WorkFailed("expected OpenGL (EGL or OSMesa) to draw pictures with, this system has none")
    plotter.set_background("white")
    return plotter


def write_picture(path: Path, trajectory: Trajectory, colour: Colour, frame: int) -> None:
    """Draw `frame` into a PNG. Raises InputError and WorkFailed."""
    with Picture(trajectory, colour, smooth=True) as picture:
        image = picture.at(frame)
    with replacing(path) as part:
        imsave(part, image)


def write_movie(path: Path, trajectory: Trajectory, colour: Colour, frames: Sequence[int], *, rate: int) -> None:
    """Draw `frames` into an MP4 of `rate` frames a second. Raises InputError and WorkFailed."""
    with Picture(trajectory, colour) as picture, replacing(path) as part, av.open(str(part), "w") as file:
        stream = file.add_stream("libx264", rate=rate)
        stream.width, stream.height = picture.plotter.window_size
        stream.pix_fmt = "yuv420p"
        for frame in tqdm(frames, desc="movie", unit="frame"):
            file.mux(stream.encode(av.VideoFrame.from_ndarray(picture.at(frame), format="rgb24")))
        file.mux(stream.encode())
