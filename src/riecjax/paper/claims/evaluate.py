"""Every statement that the numbers at hand decide."""

from riecjax.paper.claims.claim import Claim
from riecjax.paper.claims.section_6 import variation_claims
from riecjax.paper.claims.sections_2_and_4 import (
    bounded_impulse,
    drop_outs,
    window_errors,
    window_lengths,
)
from riecjax.paper.claims.tables import table_claims
from riecjax.paper.study import PaperStudy


def evaluate_claims(study: PaperStudy) -> list[Claim]:
    """All 17, in the order of their numbers."""
    claims = [
        *table_claims(study.roads, study.ramps),
        bounded_impulse(study.demonstrations),
        drop_outs(),
        window_errors(study.window_errors),
        window_lengths(study.lengths),
        *variation_claims(study.variations, study.damper),
    ]
    return sorted(claims, key=lambda claim: claim.id)
