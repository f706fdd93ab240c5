"""The one exception that means "the input is wrong" rather than "the program is"."""


class InputError(ValueError):
    """A user's mistake in one line: which file, which key, what was expected.

    Commands print the line to stderr and exit with status 2 (see `datasets.command_line`).
    """

    def __init__(self, message: str, *, where: str = "", key: str = "") -> None:
        self.message, self.where, self.key = message, where, key
        super().__init__(": ".join(part for part in (where, key, message) if part))

    def at(self, where: str) -> "InputError":
        """The same mistake with the file it stands in."""
        return InputError(self.message, where=where, key=self.key)


class OutOfRange(InputError):
    """Known keys and right types, but a value, or values together, that cannot be."""
