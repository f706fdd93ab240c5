"""The frame of every command of Talus: flags by cyclopts, errors in one line, exit status 0, 1 or 2.

A command is a function. `python -m MODULE` runs the module's function; `talus NAME` finds the same one in a table.
"""

import errno
import os
import shlex
import signal
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any, get_args

from datasets.errors import InputError, WorkFailed
from datasets.processes import Terminated, terminable

if TYPE_CHECKING:
    from cyclopts import App, Token

Commands = Mapping[str, tuple[str, str]]
"""Name -> MODULE:FUNCTION, or MODULE:TABLE of further commands; and a description."""

DISK_ERRORS = {"ENOSPC", "EDQUOT", "EFBIG", "EROFS", "EACCES", "EPERM", "EIO", "ESTALE"}
"""Errors of a disk that is full, read-only or broken, which are no errors of the program."""
_running: list[str] = []  # command lines; if one command calls another, the called one is last


def invocation() -> str:
    """The running command line, quoted for a shell; empty in a user's own script."""
    return _running[-1] if _running else ""


def run(command: Callable[..., Any] | Commands, name: str, arguments: Sequence[str] | None = None) -> int:
    """Run a command, or the first-named command of a table, with the flags on the command line, and print the text that
    it returns. A user's error or a failing disk gives no traceback. Returns the exit status: 0 done, 1 the work failed,
    2 the input is wrong; 130 after Ctrl-C, 143 after SIGTERM."""
    from cyclopts import CycloptsError  # imported here: users of this module's other functions do not need it

    given = sys.argv[1:] if arguments is None else list(arguments)
    _running.append(f"{name} {shlex.join(given)}".strip())
    python_format = warnings.formatwarning
    # Print the text of a warning without its place in the program.
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
        # As in `talus scenes | head`. Python would flush once more.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        if not disk_failed(error):
            raise
        print(f"talus: {error.filename or 'output'}: {error.strerror}; what was finished is kept", file=sys.stderr)
        return 1
    except MemoryError:
        print("talus: not enough memory; choose larger cells, fewer frames or fewer jobs", file=sys.stderr)
        return 1
    except KeyboardInterrupt as interrupt:
        print(f"talus: interrupted; {str(interrupt) or 'what was finished is kept'}", file=sys.stderr)
        return 128 + (signal.SIGTERM if isinstance(interrupt, Terminated) else signal.SIGINT)
    finally:
        warnings.formatwarning = python_format
        _running.pop()
    return result if isinstance(result, int) else 0


def application(command: Callable[..., Any] | Commands, name: str, arguments: Sequence[str]) -> "App":
    """A command, or a table of commands, as a cyclopts application; from a table it imports only the named command."""
    from cyclopts import App, Parameter

    # Talus handles Ctrl-C itself: cyclopts would exit silently with its own status.
    text = "" if isinstance(command, Mapping) else command.__doc__
    whole = Parameter(converter=converted)
    app = App(name=name, help=text, version_flags=[], suppress_keyboard_interrupt=False, default_parameter=whole)
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


def converted(kind: Any, tokens: "Sequence[Token]") -> Any:
    """The value of a flag. Raises ValueError for a fraction where an integer is expected: cyclopts would round it."""
    from cyclopts import convert

    for token in tokens if int in (kind, *get_args(kind)) else ():
        if "." in token.value:
            raise ValueError(f"expected an integer, got {token.value}")
    return convert(kind, tokens)


def disk_failed(error: BaseException) -> bool:
    """Whether an error means that the disk is full, read-only or broken, so that no other file can be written."""
    return isinstance(error, OSError) and errno.errorcode.get(error.errno or 0) in DISK_ERRORS
