"""In which order a candidate meets the starts of a bank: the same for who runs and who judges."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from hashlib import sha256

from nw_eval.results.bank.start import Stratum
from nw_eval.results.provenance import PolicyInfo
from nw_eval.stats.bank import order_of_starts
from nw_eval.suite.model import Suite, new_suite


def draw_starts(
    strata: Iterable[Stratum], starts: int, *, candidate: str, suite_digest: str
) -> Mapping[Stratum, list[int]]:
    """Return for each scene, and what is changed there, its starts in the order of the rounds.

    Args:
        strata: of the bank.
        starts: M, in each.
        candidate: who is judged, by its `key`: the order is one for each checkpoint with its card.
        suite_digest: of the suite.
    """
    return {
        (scene, cell): order_of_starts(
            starts,
            candidate_digest=candidate,
            suite_digest=suite_digest,
            scene=scene + "".join(f" {axis}={value!r}" for axis, value in cell),
        )
        for scene, cell in strata
    }


def fresh_seed(candidate: PolicyInfo, suite: Suite) -> int:
    """Return the seed of the starts that only this candidate meets in a suite, 0 to 2^63 - 1.

    It is the first 63 bits of sha256("fresh/<checkpoint digest>/<card digest>/<suite digest>"), the
    digest being that of the suite with seed 0. So nobody chooses it: a checkpoint has one fresh
    panel in a suite, whatever panel is pinned there.

    Args:
        candidate: who is judged.
        suite: what it is to meet, with any seed.
    """
    unseeded = new_suite({**suite.model_dump(by_alias=True), "seed": 0}).digest
    text = f"fresh/{candidate.key}/{unseeded}"
    return int.from_bytes(sha256(text.encode()).digest()[:8], "big") >> 1
