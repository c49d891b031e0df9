"""In which order a candidate meets the starts of a bank: the same for who runs and who judges."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from nw_eval.results.bank.start import Stratum
from nw_eval.results.provenance import PolicyInfo
from nw_eval.stats.bank import order_of_starts


def draw_starts(
    strata: Iterable[Stratum], starts: int, *, candidate: PolicyInfo, suite_digest: str
) -> Mapping[Stratum, list[int]]:
    """Return for each scene, and what is changed there, its starts in the order of the rounds.

    Args:
        strata: of the bank.
        starts: M, in each.
        candidate: who is judged; the order is one for each checkpoint with its card.
        suite_digest: of the suite.
    """
    who = f"{candidate.checkpoint_digest}/{candidate.card_digest}"
    return {
        (scene, cell): order_of_starts(
            starts,
            candidate_digest=who,
            suite_digest=suite_digest,
            scene=scene + "".join(f" {axis}={value!r}" for axis, value in cell),
        )
        for scene, cell in strata
    }
