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
    minimum: float = -math.inf
    """The smallest value that passes."""
    maximum: float = math.inf
    """The largest value that passes."""

    @property
    def ok(self) -> bool:
        """Whether it passes; NaN does not."""
        return self.minimum <= self.value <= self.maximum

    @property
    def range(self) -> str:
        """The range, to be read."""
        if math.isinf(self.maximum):
            return f"≥ {self.minimum:.4g}"
        return f"≤ {self.maximum:.4g}" if math.isinf(self.minimum) else f"{self.minimum:.4g} to {self.maximum:.4g}"

    @property
    def excess(self) -> float:
        """How far outside the range it lies; at most 0 where it passes."""
        return max(self.minimum - self.value, self.value - self.maximum)

    def __str__(self) -> str:
        return f"{self.check} {self.value:.4g} {self.unit}".strip() + f" (required {self.range})"
