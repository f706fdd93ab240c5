"""What a loop leaves: the result, and what its report shows beside it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inverse.observations.deposit import Values
from inverse.parameters.parameters import Vector
from inverse.result import Result
from validation.loop.certainty import Certainty
from validation.loop.search import Checked


@dataclass(frozen=True, kw_only=True)
class Answer:
    """The unknowns found and what the MPM says of them, on average over the jitter seeds that were run there."""

    unknowns: Vector
    runs: Sequence[Checked]
    """One, where one was enough."""

    @property
    def observation(self) -> Values:
        """Mean observation [m], shape [M]."""
        return np.asarray(np.mean([run.observation for run in self.runs], axis=0))

    @property
    def front_error(self) -> float:
        """Mean relative error of the front, with its sign; nan where the target tells nothing of a front."""
        return float(np.mean([run.front_error for run in self.runs]))


@dataclass(frozen=True, kw_only=True)
class Solved:
    """The result of a loop and what its report shows beside it."""

    result: Result
    answer: Answer
    proposed: Checked
    """The MPM run at what the surrogate alone had found."""
    alone: str | None = None
    """Why no learned surrogate proposed; None where one did."""
    begun: Checked | None = None
    """Of a design: the MPM run at the problem's own start."""
    certainty: Certainty | None
    """Absent where the target is out of reach."""
    surrogate_deposit: NDArray[np.floating]
    """Deposit of the uncorrected surrogate at the answer [m], shape [n, D]."""
