"""Trials whose images no longer showed the scene: they are counted apart, for neither side.

What a policy does in fog says nothing of it. So such a trial is no success and no failure, and its
start is unknown: whatever would speak for the policy counts it as the worst that it could have
been, and whatever would flag as the best. Then neither error grows, whichever trials leave; if
they were left out, a policy that walks into the fog where it would fail would pass. Where more than
a share of all trials leave, the run says too little to be judged.

A policy that failed by itself (`policy_failed`) has failed wherever it was.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from nw_base.plural import plural
from nw_gate.results.row import VIEW_RATE, Row
from nw_gate.settings import Gate, Validity

_SLACK = 1e-9  # against rounding of tenths and shares


def seconds_outside(row: Row, validity: Validity) -> float:
    """Return the longest simulated time in a row that a trial's images were beyond a limit, s.

    0 where the row has no such numbers: the policy saw no splat, or the capture cameras of the
    scene are unknown.
    """
    longest = lasting = 0
    views = zip(row.capture_distance, row.capture_angle, row.capture_alpha, strict=False)
    for distance, angle, alpha in views:
        lasting = lasting + 1 if _is_beyond(distance, angle, alpha, validity) else 0
        longest = max(longest, lasting)
    return longest / VIEW_RATE


def has_left(row: Row, gate: Gate) -> bool:
    """Return whether a trial with a result has left the captured volume."""
    if gate.validity is None or row.success is None or row.outcome == "policy_failed":
        return False
    return seconds_outside(row, gate.validity) > gate.validity.longer_than + _SLACK


def that_left(rows: Iterable[Row], gate: Gate) -> frozenset[str]:
    """Return the trials that have left the captured volume."""
    if gate.validity is None:
        return frozenset()
    return frozenset(row.trial_id for row in rows if has_left(row, gate))


def over_the_cap(rows: Sequence[Row], left: frozenset[str], gate: Gate) -> str | None:
    """Return why so many trials left that nothing is judged, in a sentence; None if few enough did.

    Args:
        rows: of the run; those of informational scenes do not count.
        left: the trials that left.
        gate: of the suite.
    """
    if gate.validity is None:
        return None
    counted = [
        row for row in rows if row.success is not None and gate.tier(row.scene) != "informational"
    ]
    count = sum(row.trial_id in left for row in counted)
    if not too_many(count, len(counted), gate):
        return None
    return (
        f"{count} of {plural(len(counted), 'trial')} left the captured volume, over "
        f"gate.validity.at_most {gate.validity.at_most:g}: too few show the policy and not the "
        "fog; capture more of the scene from the robot's height, or widen the limits"
    )


def too_many(left: int, trials: int, gate: Gate) -> bool:
    """Return whether more of some trials left the captured volume than the suite allows."""
    most = 0.0 if gate.validity is None else gate.validity.at_most
    return left > most * trials + _SLACK


def in_a_sentence(rows: Sequence[Row], left: frozenset[str], gate: Gate) -> tuple[str, ...]:
    """Return how many trials left, and how many scenes could not be checked.

    Args:
        rows: the run's.
        left: the trials that left.
        gate: of the suite.
    """
    if gate.validity is None:
        return ()
    sentences: list[str] = []
    if left:
        scenes = plural(len({row.scene for row in rows if row.trial_id in left}), "scene")
        sentences.append(
            f"{plural(len(left), 'trial')} left the captured volume for longer than "
            f"{gate.validity.longer_than:g} s in {scenes}, and count for neither side: as failures "
            "for a PASS, as successes for a REGRESSED"
        )
    seeing = {row.scene for row in rows if row.coverage_mean is not None}
    known = {row.scene for row in rows if row.capture_alpha}
    if unknown := seeing - known:
        sentences.append(
            f"gate.validity was not looked at in {plural(len(unknown), 'scene')} that no "
            "`captures` says from where it was photographed"
        )
    return tuple(sentences)


def _is_beyond(distance: float, angle: float, alpha: float, validity: Validity) -> bool:
    return (
        (validity.distance is not None and distance > validity.distance)
        or (validity.angle is not None and angle > validity.angle)
        or (validity.alpha is not None and alpha < validity.alpha)
    )
