"""What the observation says of the parameters, over the whole box: an emulator of the MPM, its posterior, its answers.

Vectors of parameters are here in fractions of their ranges between the prior bounds: v in [0, 1]^U.
"""

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]  # a row for each vector of parameters, run or sample
Row = NDArray[np.float64]  # a number for each of them
