"""Frames on disk while a run goes on: what a scene records need not fit into memory."""

import mmap
import os
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets.files import PART, make_folder


class DiskFrames:
    """The positions of one scene in a file without a name, which ends with the process.

    All of it is reserved at once: a map whose disk fills up would end the process without a word. Raises OSError where
    the disk has no room, InputError as `make_folder`.
    """

    def __init__(self, folder: Path, shape: tuple[int, int, int]) -> None:
        make_folder(folder)
        size = 4 * int(np.prod(shape, dtype=np.int64))
        with tempfile.TemporaryFile(dir=folder, prefix=PART) as file:
            try:
                if hasattr(os, "posix_fallocate"):
                    os.posix_fallocate(file.fileno(), 0, size)
                else:
                    file.truncate(size)
            except OSError as error:
                error.filename = str(folder)
                raise
            self._map = mmap.mmap(file.fileno(), size)
        self.positions: NDArray[np.float32] = np.frombuffer(self._map, np.float32).reshape(shape)
        """Of the kept frames [m], shape [T, N, D]."""
        self.finite = True
        """Whether all that was put there are numbers: nobody has to read it again to know."""

    def put(self, first: int, frames: NDArray[np.float32]) -> None:
        """Bring `frames`, the kept ones from number `first` on, to the disk."""
        self.positions[first : first + len(frames)] = frames
        self.finite &= bool(np.isfinite(frames).all())
        if hasattr(mmap, "MADV_DONTNEED"):
            # The pages are the system's to write; this process no longer holds them.
            self._map.madvise(mmap.MADV_DONTNEED)
