"""What becomes of a trial that ended in an error: another attempt, a result, or an error for good.

A trial that ends in an error is run once more, in a process of its own. If the policy itself failed
both times in the same way (`words.PolicyFault`), that is what the policy does, and the trial's
result. Everything else stays an error: a machine's fault is never a failure of the policy. Since it
says nothing about the policy at all, a policy's failure that comes only after one has its second
attempt still to come.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from nw_eval.clean import clean
from nw_eval.rollout.result import as_outcome, policy_fault

if TYPE_CHECKING:
    from nw_eval.results.row import Row
    from nw_eval.rollout.result import TrialResult

_BEFORE = "; the attempt before: "
_NOW, _EARLIER = 600, 300  # Characters of each, so that no later cut loses one of them.


def settled(result: TrialResult, before: Row | None) -> TrialResult:
    """Return what an attempt comes to in the light of the one before.

    Args:
        result: of this attempt.
        before: the row of the attempt before, an error; None if there was none.
    """
    if result.status == "ok" or before is None:
        return result
    fault = policy_fault(result)
    if fault is not None and fault == policy_fault(before):
        return as_outcome(result)
    if (result.error_type, fault) == (before.error_type, policy_fault(before)):
        return result
    earlier = clean(before.error_text.partition(_BEFORE)[0], at_most=_EARLIER)
    return replace(result, error_text=f"{clean(result.error_text, at_most=_NOW)}{_BEFORE}{earlier}")


def is_open(row: Row, before: Row | None) -> bool:
    """Whether a trial deserves another attempt after the one of this row.

    Args:
        row: of an attempt.
        before: the row of the attempt before it in the same run; None if this was the first.
    """
    if row.status == "ok":
        return False
    return before is None or (policy_fault(row) is not None and policy_fault(before) is None)
