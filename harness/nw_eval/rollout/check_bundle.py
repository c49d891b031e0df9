"""Checks a bundle before any physics: its card, and its checkpoint on one observation of zeros."""

from __future__ import annotations

from nw_eval.policies import Bundle
from nw_eval.policies.trying import ShownInput, try_bundle
from nw_eval.robots import RobotSpec
from nw_eval.sensors.check import ObservationSpec, check_card


def check_bundle(
    bundle: Bundle,
    robot: RobotSpec | None = None,
    *,
    allow_code: bool = False,
    may_fail: bool = False,
    seconds: int | None = None,
) -> tuple[ObservationSpec, ...]:
    """Check a card against its robot and its files of weights: sizes, and one action on zeros.

    Args:
        bundle: card and checkpoint.
        robot: the robot that the suite runs; None = the card's own.
        allow_code: whether Python code that the card names may be imported.
        may_fail: whether a NaN or inf that it answers to zeros is left to its trials, which fail
            of it: it is the policy's own failure, and no fault of the card.
        seconds: of processor time that the policy's process may take; None = its own limit.

    Raises:
        PolicyError: as `check_card`; the checkpoint, or a network that feeds it, cannot be loaded,
            wants another number of values than the card makes, or fails on zeros.
    """
    code_from = bundle.folder if allow_code else None
    specs = check_card(bundle.card, robot, where=bundle.card_path, code_from=code_from)
    shown = [ShownInput(spec.name, spec.shape, spec.dtype.str, spec.reckoning) for spec in specs]
    try_bundle(bundle, shown, allow_code=allow_code, may_fail=may_fail, seconds=seconds)
    return specs
