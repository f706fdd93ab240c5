"""How every command of Talus begins and ends: flags by cyclopts, mistakes in one line, exit status 0, 1 or 2.

A command is a function. `python -m MODULE` runs that of its module; `talus NAME` finds the same function in a table.
"""

import errno
import os
import shlex
import signal
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

from datasets.errors import InputError, WorkFailed
from datasets.processes import Terminated, terminable

if TYPE_CHECKING:
    from cyclopts import App

Commands = Mapping[str, tuple[str, str]]
"""By name: MODULE:FUNCTION, or MODULE:TABLE of further commands, and what it does."""

DISK_ERRORS = {"ENOSPC", "EDQUOT", "EFBIG", "EROFS", "EACCES", "EPERM", "EIO", "ESTALE"}
"""What a disk says that is full, read-only or broken: no mistake of the program's."""


_running: list[str] = []  # command lines, of which one that another calls is the last


def invocation() -> str:
    """The command line that runs, as a shell takes it; empty in a script of one's own."""
    return _running[-1] if _running else ""


def run(command: Callable[..., Any] | Commands, name: str, arguments: Sequence[str] | None = None) -> int:
    """Run a command, or that of a table which is named first, with the flags on the command line. Prints the text that
    it returns. No traceback for a user's mistake, nor for a failing disk. Returns its exit status: 0 done, 1 the work
    failed, 2 the input is wrong; 130 after Ctrl-C, 143 after SIGTERM."""
    from cyclopts import CycloptsError  # whoever needs an exception alone waits for no parser of flags

    given = sys.argv[1:] if arguments is None else list(arguments)
    _running.append(f"{name} {shlex.join(given)}".strip())
    python_format = warnings.formatwarning
    # What a warning says, without the place in the program that says it.
    warnings.formatwarning = lambda message, *_, **__: f"talus: {message}\n"
    try:
        with terminable():
            app = application(command, name, given)
            result = app(given, exit_on_error=False, print_error=False, result_action="return_value")
            if isinstance(result, str):
                print(result)
            sys.stdout.flush()
    except (CycloptsError, InputError) as error:
        print(f"talus: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except WorkFailed as error:
        print(f"talus: {error}", file=sys.stderr)
        return 1
    except BrokenPipeError:
        # Of `talus scenes | head`. Python would flush once more.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
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
        _running.pop()
    return result if isinstance(result, int) else 0


def application(command: Callable[..., Any] | Commands, name: str, arguments: Sequence[str]) -> "App":
    """A command, or a table of commands, as an application of cyclopts; of a table it imports the command named."""
    from cyclopts import App

    # Ctrl-C is ours: cyclopts would leave with a status of its own, and silently.
    text = "" if isinstance(command, Mapping) else command.__doc__
    app = App(name=name, help=text, version_flags=[], suppress_keyboard_interrupt=False)
    if not isinstance(command, Mapping):
        app.default(command)
        return app
    for key, (place, what) in command.items():
        if arguments[:1] == [key]:
            module, _, attribute = place.partition(":")
            app.command(application(getattr(import_module(module), attribute), key, arguments[1:]))
        else:
            app.command(lambda: None, name=key, help=what)
    return app


def disk_failed(error: BaseException) -> bool:
    """Whether an error says that the disk is full, read-only or broken, so that no other file can be written either."""
    return isinstance(error, OSError) and errno.errorcode.get(error.errno or 0) in DISK_ERRORS
