"""The one exception that means "the input is wrong" rather than "the program is"."""

LONGEST = 1000
"""Characters of what is said: a file may be anybody's, and what it has in place of a number may be long."""


class InputError(ValueError):
    """A user's mistake in one line: which file, which key, what was expected.

    Commands print the line to stderr and exit with status 2 (see `datasets.command_line`).
    """

    def __init__(self, message: str, *, where: str = "", key: str = "") -> None:
        short = message if len(message) <= LONGEST else f"{message[:LONGEST]}..."
        self.message, self.where, self.key = short, where, key
        super().__init__(": ".join(part for part in (where, key, short) if part))

    def at(self, where: str) -> "InputError":
        """The same mistake with the file it stands in."""
        return InputError(self.message, where=where, key=self.key)


class OutOfRange(InputError):
    """Known keys and right types, but a value, or values together, that cannot be."""
