"""An unknown of a problem as it stands in its file: a number between bounds, or a field with a smooth prior."""

import re
from dataclasses import dataclass
from functools import cached_property
from typing import cast

from datasets.records import Record
from inverse.parameters import Kind, kind


@dataclass(frozen=True, kw_only=True)
class Parameter(Record):
    """One of `[[unknowns]]`: a number with a uniform prior between its bounds or, with a `spacing`, a field.

    A field varies over the body by the values at its nodes, with a smooth Gaussian prior (`inverse.parameters.field`).
    """

    name: str
    """See `inverse.parameters`; of a field `friction_deg`, `velocity_x`, ..., or one of these of `masses[I]`."""
    lower: float | None = None
    """Smallest value allowed; of a velocity field both bounds or none."""
    upper: float | None = None
    """Largest value allowed."""
    initial: float | None = None
    """Of a number: where the search starts."""
    spacing: tuple[float, ...] | None = None
    """Of a field: distance between nodes along each axis [m], at most; they cover the body from edge to edge.

    Along an axis for which it is longer than the body the field does not vary."""
    mean: float | None = None
    """Of a field: of its prior, everywhere [deg or m/s]."""
    deviation: float | None = None
    """Of a field: standard deviation of its prior at every node [deg or m/s]."""
    length: float | tuple[float, ...] | None = None
    """Of a field: correlation length [m], or one along each axis; at this distance the correlation is 0.14 in 2D."""

    @property
    def is_field(self) -> bool:
        """Whether it varies over the body."""
        return self.spacing is not None

    @cached_property
    def kind(self) -> Kind:
        """What the name of a number stands for. Raises InputError."""
        return kind(self.name)

    @property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest value of a number."""
        return cast("tuple[float, float]", (self.lower, self.upper))

    @property
    def start(self) -> float:
        """Where the search for a number starts."""
        return cast("float", self.initial)

    @property
    def range(self) -> float:
        """Width of the prior bounds of a number."""
        lower, upper = self.bounds
        return upper - lower

    @property
    def quantity(self) -> str:
        """Of a field: what varies, a quantity of `datasets.field.Field`."""
        return self.name.split(".")[-1]

    @property
    def mass(self) -> int | None:
        """Of a field: the index of the mass that has it; None for all."""
        found = re.match(r"masses\[(\d{1,6})\]\.", self.name)
        return None if found is None else int(found[1])
