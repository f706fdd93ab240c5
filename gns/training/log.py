"""The log of a training: `log.csv` always, TensorBoard on request."""

import csv
import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from datasets.errors import InputError

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter


class Log:
    """A row per validation, and for TensorBoard the values of every update."""

    def __init__(self, out: Path, *, size: int, updates: int, tensorboard: bool) -> None:
        """Continue after the first `size` bytes of OUT/log.csv, those after `updates` updates. Raises InputError.

        Later rows are of a run that was killed before its checkpoint, and are removed.
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

    def column(self, name: str) -> list[float]:
        """A column of log.csv, in the order of the validations."""
        with self._file.open(newline="") as file:
            return [float(row[name]) for row in csv.DictReader(file)]

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

    def update(self, updates: int, values: Mapping[str, float]) -> None:
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
