"""How every command of Talus begins and ends: flags by cyclopts, mistakes in one line, exit status 0, 1 or 2."""

import errno
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import Any

from datasets.errors import InputError, WorkFailed
from datasets.processes import Terminated, terminable

DISK_ERRORS = {"ENOSPC", "EDQUOT", "EFBIG", "EROFS", "EACCES", "EPERM", "EIO", "ESTALE"}
"""What a disk says that is full, read-only or broken: no mistake of the program's."""


def run(command: Callable[..., Any], name: str, arguments: Sequence[str] | None = None) -> int:
    """Run `command` with the flags on the command line and return its exit status.

    0 done, 1 the work failed, 2 the input is wrong; 130 after Ctrl-C, 143 after SIGTERM. No traceback for a user's
    mistake, nor for a disk that is full or read-only.
    """
    # Whoever needs an exception alone waits for no parser of flags.
    from cyclopts import App, CycloptsError

    # Ctrl-C is ours: cyclopts would leave with a status of its own, and silently.
    app = App(name=name, help=command.__doc__, version_flags=[], suppress_keyboard_interrupt=False)
    app.default(command)
    python_format = warnings.formatwarning
    # What a warning says, without the place in the program that says it.
    warnings.formatwarning = lambda message, *_, **__: f"talus: {message}\n"
    try:
        with terminable():
            given = sys.argv[1:] if arguments is None else list(arguments)
            status = app(given, exit_on_error=False, print_error=False, result_action="return_value")
    except (CycloptsError, InputError) as error:
        print(f"talus: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except WorkFailed as error:
        print(f"talus: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        if not disk_failed(error):
            raise
        print(f"talus: {error.filename or 'output'}: {error.strerror}; what was finished is kept", file=sys.stderr)
        return 1
    except MemoryError:
        print("talus: the memory of this machine did not do: larger cells, fewer frames or fewer jobs", file=sys.stderr)
        return 1
    except KeyboardInterrupt as interrupt:
        print(f"talus: interrupted; {str(interrupt) or 'what was finished is kept'}", file=sys.stderr)
        return 128 + (signal.SIGTERM if isinstance(interrupt, Terminated) else signal.SIGINT)
    finally:
        warnings.formatwarning = python_format
    return status if isinstance(status, int) else 0


def disk_failed(error: BaseException) -> bool:
    """Whether an error says that the disk is full, read-only or broken, so that no other file can be written either."""
    return isinstance(error, OSError) and errno.errorcode.get(error.errno or 0) in DISK_ERRORS
