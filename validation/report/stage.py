"""The stage of a picture: panes with a grid and scales, letters and the colour bar, in a window off-screen."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
import pyvista
from matplotlib.font_manager import findfont
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from datasets.command_line import WorkFailed
from datasets.scene import Scene
from validation.report.view import BOTTOM, LEFT, RIGHT, TOP, Place, View

INK, PANE, GRID, EDGE = "#262626", "#f6f4f0", "#dcd8cf", "#a8a398"
LETTERS = 23
"""Height of the letters at the scales [px]."""
FONT = findfont("DejaVu Sans")
"""A font that comes with matplotlib and so is everywhere the same."""
ROUND = (1, 2, 2.5, 5, 10)
"""Steps of a scale, times a power of ten."""


class Stage:
    """A window off-screen on a view. Raises WorkFailed where nothing can be drawn.

    sampling: pixels drawn per pixel of the image, along each axis; all lengths in pixels are those of the image.
    """

    def __init__(self, view: View, *, sampling: int) -> None:
        self.view, self.sampling = view, sampling
        self.plotter = _window(view.size[0] * sampling, view.size[1] * sampling)
        self.plotter.set_background("white")
        view.aim(self.plotter.camera)

    def image(self) -> NDArray[np.uint8]:
        """What is to be seen now, shape [height, width, 3]."""
        (width, height), part = self.view.size, self.sampling
        self.plotter.render()
        fine = np.asarray(self.plotter.screenshot(return_img=True)).reshape(height, part, width, part, 3)
        return np.asarray(fine.mean(axis=(1, 3)).round(), np.uint8)

    def draw_panes(self, scene: Scene) -> None:
        """Panes behind and, in 3D, below and left of the flow, with a grid; scales along their edges."""
        view, ticks = self.view, _ticks(self.view)
        for normal in (0, 1, 2) if scene.dimension == 3 else (2,):
            along, across = (axis for axis in range(3) if axis != normal)
            edges = _across(view, normal, along, (view.lower[along], view.upper[along]))
            self.plotter.add_mesh(pyvista.PolyData(np.array(edges), [4, 0, 1, 3, 2]), color=PANE, lighting=False)
            edges += _across(view, normal, across, (view.lower[across], view.upper[across]))
            grid = _across(view, normal, along, ticks[along]) + _across(view, normal, across, ticks[across])
            self.draw_lines(_segments(grid), GRID)
            self.draw_lines(_segments(edges), EDGE)
        x, y, z = view.lower
        if scene.dimension == 2:
            walls = [edge for edge in (x, view.upper[0]) if edge in (0.0, scene.domain.size[0])]
            solid = _across(view, 2, 1, [y]) + _across(view, 2, 0, walls)
            self.draw_lines(_segments(solid), INK, width=3.0)
            starts = {0: (x, y, z), 1: (x, y, z)}
        else:
            starts = {0: (x, y, view.upper[2]), 1: (x, y, view.upper[2]), 2: (view.upper[0], y, z)}
            # In the corner stands the number of x.
            ticks[2] = ticks[2][ticks[2] < view.upper[2]]
        for axis, start in starts.items():
            self._draw_scale(axis, np.array(start), ticks[axis])

    def draw_lines(self, lines: pyvista.PolyData, colour: str, *, width: float = 1.5) -> None:
        """Lines of one colour, `width` pixels wide."""
        self.plotter.add_mesh(lines, color=colour, line_width=width * self.sampling, lighting=False)

    def write(
        self,
        text: str,
        place: Place,
        *,
        across: Literal["left", "center", "right"] = "left",
        upright: Literal["bottom", "center", "top"] = "center",
        letters: int = LETTERS,
        turned: bool = False,
    ) -> pyvista.Text:
        """Put `text` at `place` [px]; across, upright: which side of it stands there."""
        actor = pyvista.Text(text, position=(place * self.sampling).round().tolist())
        actor.prop = pyvista.TextProperty(
            font_file=FONT,
            color=INK,
            font_size=letters * self.sampling,
            justification_horizontal=across,
            justification_vertical=upright,
            orientation=90.0 if turned else 0.0,
        )
        self.plotter.add_actor(actor)
        return actor

    def write_above(self, text: str) -> pyvista.Text:
        """Put `text` into the corner above the flow."""
        return self.write(text, np.array([LEFT, self.view.size[1] - TOP + 25]), upright="bottom", letters=30)

    def draw_colour_bar(self, title: str, colours: Place, marks: Mapping[float, str]) -> None:
        """A bar of `colours`, shape [K, 3], at the right; marks: what stands at which share of its height."""
        (width, height), depth = self.view.size, 0.6 * self.view.reach
        left, foot, head = width - RIGHT + 45, BOTTOM, height - TOP
        levels = np.linspace(foot, head, len(colours) + 1)
        corners = [self.view.place((x, level), depth).tolist() for level in levels for x in (left, left + 26)]
        cells = [[2 * row, 2 * row + 1, 2 * row + 3, 2 * row + 2] for row in range(len(colours))]
        bar = pyvista.PolyData.from_regular_faces(corners, cells)
        bar.cell_data["colours"] = colours
        self.plotter.add_mesh(bar, scalars="colours", rgb=True, lighting=False)
        for share, mark in marks.items():
            self.write(mark, np.array([left + 40.0, foot + share * (head - foot)]))
        self.write(title, np.array([left, head + 25.0]), upright="bottom")

    def _draw_scale(self, axis: int, start: Place, ticks: NDArray[np.float64]) -> None:
        """Numbers along an edge that begins at `start` [m], and the name of the axis; away from the flow."""
        end = start.copy()
        end[axis] = self.view.upper[axis]
        first, last = self.view.pixel(start), self.view.pixel(end)
        along = (last - first) / np.linalg.norm(last - first)
        away = np.array([-along[1], along[0]])
        if away @ (self.view.pixel(0.5 * (self.view.lower + self.view.upper)) - first) > 0.0:
            away = -away
        across: Literal["left", "center", "right"] = "center"
        if abs(away[0]) > 0.4:
            across = "left" if away[0] > 0.0 else "right"
        upright: Literal["center", "top"] = "top" if away[1] < -0.4 else "center"
        for tick in ticks:
            place = start.copy()
            place[axis] = tick
            self.write(f"{tick:g}", self.view.pixel(place) + 12.0 * away, across=across, upright=upright)
        middle, name = 0.5 * (first + last), f"{'xyz'[axis]} [m]"
        if axis == 1:
            self.write(name, middle + 75.0 * away, across="center", turned=True)
        else:
            self.write(name, middle + 50.0 * away, across=across, upright=upright)


def _window(width: int, height: int) -> Any:
    """A window of pyvista off-screen; untyped, because the decorators of its methods hide their types."""
    # What VTK tries before it finds a way to draw without a screen is of no interest.
    with pyvista.vtk_verbosity("off"):
        plotter = pyvista.Plotter(off_screen=True, window_size=[width, height])
        window: Any = plotter.render_window
        window.Initialize()
        # Without this VTK would draw into nothing and take the process with it.
        if not window.IsCurrent():
            plotter.close()
            raise WorkFailed("expected OpenGL (EGL or OSMesa) to draw pictures with, this system has none")
    return plotter


def scale_marks(lower: float, upper: float, count: int) -> NDArray[np.float64]:
    """About `count` round numbers, as far apart, from `lower` or before to `upper` or behind."""
    return np.asarray(MaxNLocator(count, steps=ROUND).tick_values(lower, upper))


def _ticks(view: View) -> list[NDArray[np.float64]]:
    """Round numbers along each axis [m], as far apart on all of them."""
    marks = scale_marks(0.0, float(np.max(view.upper - view.lower)), 7)
    step = marks[1] - marks[0]
    first = np.ceil(view.lower / step - 1.0e-6).astype(int)
    last = np.floor(view.upper / step + 1.0e-6).astype(int)
    return [step * np.arange(low, high + 1) for low, high in zip(first, last, strict=True)]


def _across(view: View, normal: int, axis: int, marks: Sequence[float] | NDArray[np.floating]) -> list[Place]:
    """Ends of lines across the pane at the lower end of axis `normal`, one line at each mark along `axis`."""
    other = 3 - normal - axis
    ends = []
    for mark in marks:
        for end in (view.lower, view.upper):
            place = view.lower.copy()
            place[axis], place[other] = mark, end[other]
            ends.append(place)
    return ends


def _segments(ends: Sequence[Place]) -> pyvista.PolyData:
    """Lines, each between two of `ends` [m], shape [3] each."""
    return pyvista.line_segments_from_points(np.array(ends, np.float64))
