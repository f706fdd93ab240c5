"""The posterior of the parameters over the whole box: an emulator of the MPM, samples, separate answers.

Vectors of parameters are in fractions of the ranges between the prior bounds: v in [0, 1]^U.
"""

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]  # a row for each vector of parameters, run or sample
Row = NDArray[np.float64]  # a number for each of them
