"""A picture of a frame of a trajectory by pyvista, off-screen: particles coloured by a field, the solids, the time."""

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pyvista
from matplotlib import colormaps
from matplotlib.colors import ListedColormap
from matplotlib.image import imsave
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from datasets.errors import InputError, WorkFailed
from datasets.exchange.vtk import Meshes, edges, extent, spatial
from datasets.files import replacing
from datasets.flow.fields import RANGE_QUANTILE, SCALES, Colour, FlowFields
from datasets.flow.trajectory import Trajectory
from datasets.geometry.surface import body_of, solids_of

Floats = NDArray[np.floating]

DIAMETER = 1.25  # diameter of a drawn particle over the initial particle spacing
INK, STEEL, GROUND, FAINT = "#262626", "#8d9aa8", "#b5aa98", "#77736a"
"""Colours of the letters, of the baffles, of other solids and of the masses' outlines."""
EYE = {2: (0.0, 0.0, 1.0), 3: (0.45, 0.55, 1.0)}
"""Direction from the flow to the eye, by dimension: in 3D x runs to the right and slightly nearer, seen from above."""
WIDTH, HEIGHT = 1600, 1200  # largest size of an image [px]
MARGIN = np.array([0.26, 0.24])
"""Share of the image's width and height for axes, colour bar and time."""
BAR = {"vertical": True, "position_x": 0.91, "position_y": 0.2, "height": 0.55, "width": 0.05, "fmt": "%.3g"}
LETTERS = {"color": INK, "title_font_size": 20, "label_font_size": 20}


def require_recorded(trajectory: Trajectory, colour: Colour) -> None:
    """Raise InputError if `trajectory` has not recorded the field that `colour` shows."""
    missing = colour in (Colour.PRESSURE, Colour.PLASTIC_STRAIN) and getattr(trajectory, colour) is None
    if missing or (colour is Colour.VELOCITY and FlowFields(trajectory).velocity(0) is None):
        raise InputError("expected a trajectory that recorded it, this one did not", key=colour)


def write_picture(path: Path, trajectory: Trajectory, colour: Colour, frame: int) -> None:
    """Draw `frame` into a PNG, coloured by a field that `require_recorded` admits. Raises WorkFailed without OpenGL."""
    plotter = drawn(trajectory, colour, frame)
    try:
        with replacing(path) as part:
            imsave(part, plotter.screenshot(return_img=True))
    finally:
        plotter.close()


def drawn(trajectory: Trajectory, colour: Colour, frame: int) -> Any:
    """A plotter of pyvista with a frame in it; untyped, because the decorators of its methods hide their types."""
    meshes, scene = Meshes(trajectory), trajectory.scene
    corners = np.stack(extent(scene, trajectory.positions))
    # The picture ends at round numbers, multiples of the axis ticks.
    step = float(np.diff(MaxNLocator(8, steps=(1, 2, 5, 10)).tick_values(0.0, np.ptp(corners, axis=0).max()))[0])
    corners = step * np.stack([np.floor(corners[0] / step + 1e-6), np.ceil(corners[1] / step - 1e-6)])
    counts = np.rint(np.ptp(corners, axis=0) / step).astype(int) + 1
    eye = np.array(EYE[scene.dimension]) / np.linalg.norm(EYE[scene.dimension])
    right = np.cross((0.0, 1.0, 0.0), eye) / np.linalg.norm(np.cross((0.0, 1.0, 0.0), eye))
    up = np.cross(eye, right)
    extents = np.ptp(np.array([*product(*corners.T)]) @ np.stack([right, up]).T, axis=0)
    # Pixels per metre.
    scale = float(np.min((WIDTH, HEIGHT) * (1.0 - MARGIN) / extents))
    width, height = np.maximum(extents * scale / (1.0 - MARGIN), (WIDTH // 2, HEIGHT // 3)).astype(int).tolist()
    plotter = window(width, height)
    # The flow is slightly off the middle, to leave room for the colour bar.
    focus, depth = corners.mean(axis=0) + (0.03 * width * right - 0.02 * height * up) / scale, np.ptp(corners)
    camera = plotter.camera
    camera.focal_point, camera.position, camera.up = tuple(focus), tuple(focus + 2.0 * depth * eye), (0.0, 1.0, 0.0)
    camera.parallel_projection, camera.parallel_scale = True, 0.5 * height / scale
    camera.clipping_range = (0.1 * depth, 5.0 * depth)
    for mass in [mass for mass in scene.masses if mass.kind == "box"]:
        plotter.add_mesh(edges(mass.lower, mass.size), color=FAINT, line_width=1.5, lighting=False)
    if scene.baffles or scene.solids:
        add_solids(plotter, meshes, corners)
    add_particles(plotter, meshes, colour, frame, scale)
    flat = scene.dimension == 2
    labels: dict[str, Any] = {"xtitle": "x [m]", "ytitle": "y [m]", "ztitle": "z [m]"}
    labels |= dict(zip(("n_xlabels", "n_ylabels", "n_zlabels"), counts.tolist(), strict=True))
    style = {"color": INK, "font_size": 20, "bold": False, "location": "outer", "ticks": "outside", "fmt": "%.3g"}
    sides = {"grid": "front" if flat else "back", "show_zaxis": not flat, "use_2d": flat}
    plotter.show_bounds(bounds=corners.T.ravel().tolist(), **sides, **labels, **style)
    # On a slope, too, the box is drawn level.
    time = f"t = {trajectory.time[frame]:.3f} s" + (f"   slope {scene.slope_deg:g}°" if scene.slope_deg else "")
    plotter.add_text(time, position=(0.03, 0.93), viewport=True, font_size=12, color=INK)
    return plotter


def window(width: int, height: int) -> Any:
    """An empty off-screen plotter. Raises WorkFailed if drawing is impossible."""
    # VTK's messages while it looks for a way to draw without a screen are suppressed.
    with pyvista.vtk_verbosity("off"):
        plotter: Any = pyvista.Plotter(off_screen=True, window_size=[width, height])
        plotter.render_window.Initialize()
        # Without this check VTK would crash the process.
        if not plotter.render_window.IsCurrent():
            plotter.close()
            raise WorkFailed("expected OpenGL (EGL or OSMesa) to draw pictures with, this system has none")
    plotter.set_background("white")
    plotter.enable_anti_aliasing("ssaa")
    return plotter


def add_solids(plotter: Any, meshes: Meshes, corners: Floats) -> None:
    """Baffles and other solids as far as they lie between the corners [2, 3] of the picture; areas in 2D."""
    scene, count = meshes.trajectory.scene, len(meshes.trajectory.scene.baffles)
    box = corners.copy()
    if scene.dimension == 2:
        box[:, 2] = -1.0, 1.0
        parts = []
        for solid, key in zip(*solids_of(scene), strict=True):
            ring = spatial(body_of(solid, key, scene.domain, continues=False).vertices)
            parts.append(pyvista.PolyData(ring, [len(ring), *range(len(ring))]).triangulate())
        solids = [(part, number < count) for number, part in enumerate(parts)]
    else:
        surface = meshes.part("solids", 0)
        solids = [
            (surface.extract_cells(np.flatnonzero(chosen).tolist()).extract_surface(algorithm=None), baffles)
            for chosen, baffles in ((surface["solid"] < count, True), (surface["solid"] >= count, False))
            if chosen.any()
        ]
    for mesh, baffles in solids:
        shown = mesh.clip_box(box.T.ravel().tolist(), invert=False).extract_surface(algorithm=None)
        plotter.add_mesh(shown, color=STEEL if baffles else GROUND, ambient=0.25, lighting=scene.dimension == 3)
        if baffles:
            plotter.add_mesh(shown.clean().extract_feature_edges(), color=INK, line_width=1.5, lighting=False)


def add_particles(plotter: Any, meshes: Meshes, colour: Colour, frame: int, scale: float) -> None:
    """The particles and the colour bar; scale: pixels per metre."""
    field, flow = SCALES[colour], meshes.trajectory
    here = flow.entered(float(flow.time[frame]))
    cloud = pyvista.PolyData(spatial(flow.positions[frame][here]))
    cloud.point_data["colour"] = values = field.scaled(meshes.fields.at_frame(frame)[colour][here])
    colours: Any = field.colours
    if colour is Colour.MATERIAL:
        materials = meshes.fields.materials
        limits, marks = (-0.5, len(materials) - 0.5), 0
        colours = ListedColormap(colormaps[field.colours](np.arange(len(materials)) % 8)[:, :3])
        names = {float(index): f"{index}: {material.friction_deg:g}°" for index, material in enumerate(materials)}
    else:
        finite = values[np.isfinite(values)]
        top = float(np.quantile(finite, RANGE_QUANTILE)) if len(finite) else 0.0
        limits, marks, names = (0.0, top or 1.0), 5, None
    plotter.add_mesh(
        cloud,
        scalars="colour",
        clim=limits,
        cmap=colours,
        annotations=names,
        style="points",
        render_points_as_spheres=True,
        point_size=max(2.0, DIAMETER * meshes.fields.spacing * scale),
        # Shaded, but lightly, so that the colours can be read.
        ambient=0.35,
        diffuse=0.75,
        scalar_bar_args={"title": field.title, "n_labels": marks, **BAR, **LETTERS},
    )
