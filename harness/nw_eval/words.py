"""The words for how trials end, and how much their scenes count, each list of them defined once."""

from __future__ import annotations

from typing import Literal, get_args

Outcome = Literal[
    "completed", "fell", "collided", "stuck", "off_course", "timeout", "policy_failed"
]
"""How a trial that ran can end. `policy_failed`: the policy itself failed, twice in one way."""

PolicyFault = Literal["exception", "action", "diverged", "exit"]
"""How a policy itself fails: its code raised; its action is not finite numbers, or huge; the
physics diverged under what it told the motors; its process ended by itself in mid-trial."""

Fault = Literal["policy_error", "physics_error", "crashed", "hung"]
"""How a trial can fail to come to a result: never counted as a failure of the policy."""

Tier = Literal["critical", "supporting", "informational"]
"""How much a scene counts for the verdict: alone, in the mean, or not at all."""

OUTCOMES: tuple[Outcome, ...] = get_args(Outcome)
POLICY_FAULTS: tuple[PolicyFault, ...] = get_args(PolicyFault)
FAULTS: tuple[Fault, ...] = get_args(Fault)
TIERS: tuple[Tier, ...] = get_args(Tier)
