"""What a training writes down as it goes: `log.csv` always, TensorBoard on request."""

import csv
import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from datasets.errors import InputError

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter


class Log:
    """A row per validation, and for TensorBoard a point per update."""

    def __init__(self, out: Path, *, size: int, updates: int, tensorboard: bool) -> None:
        """Go on after the first `size` bytes of OUT/log.csv, as they were after `updates` updates. Raises InputError.

        What stands behind them was written by a run that stopped before it could save what it wrote.
        """
        self._file = out / "log.csv"
        out.mkdir(parents=True, exist_ok=True)
        self._file.touch()
        with self._file.open("r+b") as file:
            file.truncate(min(size, self._file.stat().st_size))
        self._board = _board(out / "tensorboard", updates) if tensorboard else None

    @property
    def size(self) -> int:
        """Bytes of log.csv."""
        return self._file.stat().st_size

    def row(self, row: Mapping[str, float]) -> None:
        """Append a row; a new file begins with the names."""
        text = io.StringIO()
        writer = csv.DictWriter(text, fieldnames=list(row), lineterminator="\n")
        if self.size == 0:
            writer.writeheader()
        writer.writerow(row)
        with self._file.open("a", newline="") as file:
            file.write(text.getvalue())
        if self._board is not None:
            for name, value in row.items():
                if name not in ("minutes", "updates"):
                    self._board.add_scalar(f"validation/{name}", value, int(row["updates"]))

    def point(self, updates: int, values: Mapping[str, float]) -> None:
        """Values of one update, for TensorBoard alone."""
        if self._board is not None:
            for name, value in values.items():
                self._board.add_scalar(f"training/{name}", value, updates)

    def close(self) -> None:
        """Write out what is still in memory."""
        if self._board is not None:
            self._board.close()


def _board(folder: Path, updates: int) -> "SummaryWriter":
    try:
        # Here, because it takes a second and is another package's.
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        message = "expected the package tensorboard to be installed: pip install tensorboard"
        raise InputError(message, key="tensorboard") from None
    return SummaryWriter(log_dir=str(folder), purge_step=updates + 1)
