"""How much of each frequency a law of windows lets into an integral: eq. (14) and Fig. 3."""

from typing import Literal

import numpy as np
from jaxtyping import Float

from riecjax.criteria.test_functions import AbstractTestFunction
from riecjax.errors import require


def expected_gain(
    frequency: Float[np.ndarray, " frequencies"],
    alpha: float,
    beta: float,
    test_function: AbstractTestFunction,
    *,
    power: Literal[1, 2] = 1,
) -> Float[np.ndarray, " frequencies"]:
    """Mean of |H|^power over T ~ U(alpha, beta), eq. (14), of the test function's `gain`.

    `power=1` is what Fig. 3 draws; `power=2` is what least squares sees: times the density of an
    error, and integrated, it is the mean square of the windows' errors.

    **Arguments:** `frequency` in hertz; `alpha`, `beta` in seconds.

    **Raises:** `ModelError` for what is no test function.
    """
    require("the test function", test_function, AbstractTestFunction, "rx.Hat(), an object")
    return test_function.mean_gain(frequency, alpha, beta, power)
