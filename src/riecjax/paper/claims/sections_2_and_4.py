"""Statements of Section 2 (1 to 3: impulses, drop-outs, windows) and Section 4 (8: alpha, beta)."""

from collections.abc import Callable

import numpy as np

from riecjax.criteria.test_functions import Boxcar, expected_gain
from riecjax.paper.claims.claim import Claim, Evidence, over_roads
from riecjax.paper.section_2 import RATE, Demonstration, WindowErrorMoments
from riecjax.paper.window_lengths import LengthMap

FROM = 0.5
"""Seconds from which growth is looked at: several periods of the mode."""
FIXED, TWO, BETWEEN = 0.1, (0.1, 0.33), (0.1, 1.0)
"""Window lengths of Fig. 3 in seconds: one, two, and a range of them."""


def bounded_impulse(demonstrations: Demonstration) -> Claim:
    """Claim 1."""
    whole = np.asarray(demonstrations.error_integral)
    share = np.max(np.abs(whole), axis=1) / np.asarray(demonstrations.bound)
    places = np.unique(np.geomspace(FROM * RATE, whole.shape[1] - 1, 60).astype(int))
    error, noise = whole[:, places], np.asarray(demonstrations.noise_integral)[:, places]

    def growth(integrals: np.ndarray) -> float:
        size = np.sqrt(np.mean(integrals**2, axis=0))
        return float(np.polyfit(np.log(places), np.log(size), 1)[0])

    return Claim(
        1,
        "The integrated mechanical error is bounded, that of white noise of equal r.m.s. is not.",
        (
            over_roads(
                "largest impulse of the error over its bound 2 m2 v_max (eq. 8)",
                lambda shares: float(np.max(shares)),
                share,
                at_most=1.0,
            ),
            over_roads("growth of the error's impulse, power of time", growth, error, at_most=0.1),
            over_roads(
                "growth of white noise's integral, power of time",
                growth,
                noise,
                at_least=0.35,
                at_most=0.65,
            ),
        ),
        "Growth is the slope of log r.m.s. over realisations against log time; a random walk has "
        "one half.",
    )


def drop_outs() -> Claim:
    """Claim 2, in closed form."""
    frequency = np.linspace(0.5, 50, 4951)
    fixed = Boxcar().gain(frequency, np.array([FIXED]))[:, 0]
    between = expected_gain(frequency, *BETWEEN, Boxcar())
    # What is left of |2 sin(w T / 2) / w| where the sine is averaged.
    smooth = (2 / np.pi) * 2 / (2 * np.pi * frequency)
    return Claim(
        2,
        "A fixed T has drop-outs; the average over T ~ U(alpha, beta) has none.",
        (
            Evidence(
                "least gain of T = 0.1 s against a smooth fall with frequency, 0.5 to 50 Hz",
                float(np.min(fixed / smooth)),
                at_most=1e-6,
            ),
            Evidence(
                "least expected gain of U(0.1, 1.0) s against the same",
                float(np.min(between / smooth)),
                at_least=0.5,
            ),
        ),
    )


def window_errors(moments: WindowErrorMoments) -> Claim:
    """Claim 3."""
    by_start = np.asarray(moments.by_start)
    return Claim(
        3,
        "Errors of random windows have equal variance and a small, equal cross-correlation (eq. "
        "18).",
        (
            over_roads(
                "mean square of the loudest eighth of starts over the mean, mean over roads",
                lambda m: float(np.max(m.mean(axis=0) / m.mean())),
                by_start,
                at_most=1.3,
            ),
            over_roads(
                "mean square of the quietest eighth over the mean",
                lambda m: float(np.min(m.mean(axis=0) / m.mean())),
                by_start,
                at_least=0.7,
            ),
            over_roads(
                "epsilon: mean product of two errors over their mean square",
                lambda e: float(np.mean(e)),
                moments.correlation,
                at_least=-0.02,
                at_most=0.02,
            ),
            over_roads(
                "scatter of epsilon over roads (standard deviation)",
                lambda e: float(np.std(e)),
                moments.correlation,
                at_most=0.02,
            ),
        ),
        "Of the body's equation in the quarter car. The symmetry is one over roads: on a single "
        "record some stretches are louder than others.",
    )


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
