"""Statement 8, of Section 4: how much identified parameters depend on alpha and beta."""

from collections.abc import Callable

import numpy as np

from riecjax.paper.claims.claim import Claim, over_roads
from riecjax.paper.window_lengths import LengthMap

SHORT = 0.05
"""Seconds, below which the text warns of windows "for models such as these"."""
LONGEST = 1.5
"""Seconds: half the period of a third of a hertz, well below the body's bounce."""
INSENSITIVE = 0.05
"""Relative change that still counts as insensitive: a quarter of the biases that the paper finds in
masses and stiffnesses."""
NARROW = 1.5
"""Ratio of beta to alpha below which they are called about equal."""


def window_lengths(lengths: LengthMap) -> Claim:
    """Claim 8."""
    alpha, beta = np.asarray(lengths.alpha), np.asarray(lengths.beta)
    theta = np.asarray(lengths.theta)
    at = lengths.of_table_2
    wide = (alpha >= SHORT) & (beta >= 2 * alpha) & (beta <= LONGEST)
    short = (beta <= SHORT) & (alpha < SHORT)
    narrow = (alpha >= SHORT) & (beta < NARROW * alpha) & (beta <= 0.3)

    def largest(chosen: np.ndarray) -> Callable[[np.ndarray], float]:
        def statistic(values: np.ndarray) -> float:
            mean = values.mean(axis=0)
            return float(np.max(np.abs(mean[chosen] / mean[at] - 1)))

        return statistic

    return Claim(
        8,
        "Parameters are insensitive to alpha and beta within limits; alpha close to beta, or both "
        "below 50 ms, brings bias back.",
        (
            over_roads(
                "largest change of a parameter, beta at least 2 alpha, from 0.05 to 1.5 s",
                largest(wide),
                theta,
                at_most=INSENSITIVE,
            ),
            over_roads(
                "largest change of a parameter, both at most 0.05 s",
                largest(short),
                theta,
                at_least=0.1,
            ),
            over_roads(
                "largest change of a parameter, alpha close to beta, 0.05 to 0.3 s, over that of "
                "wide ranges",
                lambda values: largest(narrow)(values) / largest(wide)(values),
                theta,
                at_least=2.0,
            ),
        ),
        "Change against the estimate with Table 2's lengths, mean over roads, of all "
        "eight parameters.",
    )
