"""What a check found: a number, and the range in which it has to lie."""

import math
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One check of one flow."""

    check: str
    """Which one; the same name for every flow."""
    value: float
    unit: str = ""
    least: float = -math.inf
    """The least value that passes."""
    most: float = math.inf
    """The greatest value that passes."""

    @property
    def ok(self) -> bool:
        """Whether it passes; NaN does not."""
        return self.least <= self.value <= self.most

    @property
    def range(self) -> str:
        """What was asked for, to be read."""
        if math.isinf(self.most):
            return f"≥ {self.least:.4g}"
        return f"≤ {self.most:.4g}" if math.isinf(self.least) else f"{self.least:.4g} to {self.most:.4g}"

    @property
    def excess(self) -> float:
        """How far outside the range it lies; at most 0 where it passes."""
        return max(self.least - self.value, self.value - self.most)
