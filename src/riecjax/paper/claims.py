"""Statements of the paper that Tables 1 to 5 decide, evaluated over many roads.

Numbered as in the list of 17 statements that the full study will evaluate.
"""

from typing import NamedTuple

import numpy as np

from riecjax.paper.eigenstructure import table_1
from riecjax.paper.published import CRITERIA, VARIANTS
from riecjax.paper.reproduction import TRUE_MASSES, RoadResult


class Claim(NamedTuple):
    """A statement of the paper, whether it holds here, and the numbers that say so."""

    id: int
    statement: str
    holds: bool
    evidence: dict[str, object]


def evaluate_claims(roads: RoadResult) -> list[Claim]:
    """Every claim that these roads can decide."""
    return [
        _eigenstructure(),
        _tyre_stiffness(roads),
        _masses(roads),
        _consistency(roads),
        _validation(roads),
        _true_masses(roads),
        _wheel_velocity(roads),
    ]


def _eigenstructure() -> Claim:
    agrees = [bool(row.agrees) for row in table_1()]
    return Claim(
        4,
        "The linearised source model has the eigenstructure of Table 1.",
        all(agrees),
        {"rows_that_agree": sum(agrees), "rows": len(agrees)},
    )


def _tyre_stiffness(roads: RoadResult) -> Claim:
    bias = {c: _mean(roads.parameters[c]["B_id"]["K_t"]) / 180e3 - 1 for c in CRITERIA}
    return Claim(
        5,
        "Both methods find the tyre stiffness with a very slight bias.",
        all(abs(b) < 0.03 for b in bias.values()),
        {f"bias_{c}": b for c, b in bias.items()},
    )


def _masses(roads: RoadResult) -> Claim:
    bias = {
        f"{name}_{c}": _mean(roads.parameters[c]["B_id"][name]) / true - 1
        for name, true in TRUE_MASSES.items()
        for c in CRITERIA
    }
    holds = (
        abs(bias["M_s_RIEC"]) < 0.02
        and bias["M_s_DOLS"] < -0.1
        and all(-0.3 < bias[f"M_us_{c}"] < -0.1 for c in CRITERIA)
    )
    return Claim(
        6,
        "RIEC finds the sprung mass and DOLS does not; both are about 20 % low on the unsprung.",
        holds,
        {f"bias_{k}": v for k, v in bias.items()},
    )


def _consistency(roads: RoadResult) -> Claim:
    spread = {}
    for name in ("K_s", "F_1", "F_2", "F_3", "F_4"):
        for c in CRITERIA:
            values = np.stack([np.asarray(roads.parameters[c][v][name]) for v in VARIANTS])
            spread[f"{name}_{c}"] = float(np.mean(np.ptp(values, 0) / np.abs(values.mean(0))))
    names = {key.rsplit("_", 1)[0] for key in spread}
    return Claim(
        7,
        "RIEC finds nearly the same K_s and F_i in all four variants, DOLS does not.",
        all(spread[f"{n}_RIEC"] < spread[f"{n}_DOLS"] for n in names),
        {f"relative_spread_{k}": v for k, v in spread.items()},
    )


def _validation(roads: RoadResult) -> Claim:
    ratio, share = {}, {}
    for where in ("road", "pothole"):
        for v in VARIANTS:
            riec = np.sum(roads.errors[where]["RIEC"][v], axis=-1)
            dols = np.sum(roads.errors[where]["DOLS"][v], axis=-1)
            ratio[f"{v} {where}"] = float(np.mean(riec) / np.mean(dols))
            share[f"{v} {where}"] = float(np.mean(riec < dols))
    exception = "B_true pothole"
    holds = ratio[exception] > 1 and all(r < 1 for k, r in ratio.items() if k != exception)
    return Claim(
        9,
        "RIEC validates better than DOLS in every variant, but for B_true on the pot-hole.",
        holds,
        {"error_ratio": ratio, "share_of_roads_where_better": share},
    )


def _true_masses(roads: RoadResult) -> Claim:
    ratio = {}
    for where in ("road", "pothole"):
        for c in CRITERIA:
            for side in ("W", "B"):
                true = np.sum(roads.errors[where][c][f"{side}_true"], axis=-1)
                found = np.sum(roads.errors[where][c][f"{side}_id"], axis=-1)
                ratio[f"{side} {c} {where}"] = float(np.mean(true) / np.mean(found))
    holds = all((r > 1) == key.endswith("road") for key, r in ratio.items())
    return Claim(
        10,
        "True masses validate worse than identified ones on the road, better on the pot-hole.",
        holds,
        {"error_ratio_true_over_identified": ratio},
    )


def _wheel_velocity(roads: RoadResult) -> Claim:
    share = {}
    for where in ("road", "pothole"):
        errors = np.stack(
            [np.asarray(roads.errors[where][c][v]) for c in CRITERIA for v in VARIANTS]
        )
        share[where] = [float(p) for p in errors.mean(axis=(0, 1)) / errors.mean(axis=(0, 1)).sum()]
    return Claim(
        16,
        "The wheel velocity's error p_3 is the largest of the four.",
        all(int(np.argmax(s)) == 2 for s in share.values()),
        {"share_of_p1_to_p4": share},
    )


def _mean(values: object) -> float:
    return float(np.mean(np.asarray(values)))
