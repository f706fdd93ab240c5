"""One process at a time writes into a folder of results.

The lock is the operating system's (flock, by `filelock`), which is released however a process ends. The text in the
file beside it tells users who holds the folder.
"""

import errno
import os
import shlex
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

from filelock import FileLock, Timeout, UnixFileLock

from datasets.errors import WorkFailed
from datasets.files import make_folder, remove_parts, write_text

LOCK = ".talus-lock"
HOLDER = ".talus-lock.txt"  # files in a folder while a process writes into it
NO_LOCKS = {errno.ENOLCK, errno.ENOTSUP, errno.EINVAL}  # errors of file systems that have no locks


@contextmanager
def locked(folder: Path) -> Iterator[Path]:
    """Lock `folder`, made if necessary, for this process; partial files of killed processes are removed first and last.
    Raises WorkFailed, which names the holder, if another process holds it, and InputError as `make_folder`."""
    make_folder(folder)
    lock = FileLock(folder / LOCK)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        holder = "another process writes here"
        with suppress(OSError, ValueError):
            holder = (folder / HOLDER).read_text(encoding="utf-8")
        raise WorkFailed(f"{folder}: {holder}; wait for it, or choose another folder") from None
    except OSError as error:
        if error.errno not in NO_LOCKS:
            raise
        print(f"talus: {folder}: no locks on this file system, start no second command there", file=sys.stderr)
    try:
        remove_parts(folder)
        command = " ".join(["python", *map(shlex.quote, sys.argv)])
        now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
        who = f"process {os.getpid()} on {socket.gethostname()} writes here since {now} ({command})"
        write_text(folder / HOLDER, who)
        yield folder
    finally:
        remove_parts(folder)  # also those of its own processes that a signal has ended
        (folder / HOLDER).unlink(missing_ok=True)
        # Removed while it is held: a waiting process sees that the name is gone, and starts again.
        if lock.is_locked and isinstance(lock, UnixFileLock):
            (folder / LOCK).unlink(missing_ok=True)
        lock.release()
