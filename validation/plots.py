"""A common style for all plots, and how they are written."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from datasets import files

INK, BLUE, LIGHT_BLUE, ORANGE, GREEN, GREY = "#222222", "#1b6ca8", "#9ecae1", "#d9730d", "#3a8c55", "#8a8a8a"
RED = "#b0305c"
CYCLE = {"axes.prop_cycle": f"cycler('color', {[BLUE, ORANGE, GREEN, INK, LIGHT_BLUE, GREY]!r})"}
STYLE = Path(__file__).with_suffix(".mplstyle")
DPI = 140


@contextmanager
def figure(path: Path, *, rows: int = 1, columns: int = 1, size: tuple[float, float]) -> Iterator[NDArray[Any]]:
    """Axes of shape [rows, columns] to draw on; at the end the picture is written beside `path` and moved there. size:
    of one pane [inch]."""
    # Imported here: --help does not need it.
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    with plt.style.context([STYLE, CYCLE]):
        drawn, axes = plt.subplots(rows, columns, figsize=(size[0] * columns, size[1] * rows), squeeze=False)
        try:
            yield axes
            with files.replacing(path) as part:
                drawn.savefig(part, dpi=DPI, format=path.suffix[1:])
        finally:
            plt.close(drawn)
