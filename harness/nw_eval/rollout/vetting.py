"""Checks a bundle before a run, without ever running a checkpoint's program in this process."""

from __future__ import annotations

from pathlib import Path

from nw_eval.policies import Bundle, load_bundle, physics_steps
from nw_eval.robots import get_robot
from nw_eval.rollout.isolated import call_isolated
from nw_eval.sensors import check_bundle


def vet_bundle(
    bundle: Bundle, robot: str, *, protocol: str = "strict", allow_code: bool = False
) -> None:
    """Check a card against robot, protocol and checkpoint.

    Checkpoints that are programs (TorchScript, Python) are opened in a process of their own.

    Raises:
        PolicyError: as `sensors.check_bundle`; or the card does not fit the protocol.
    """
    physics_steps(bundle.card, protocol)
    if is_program(bundle.card.adapter):
        call_isolated(
            _check,
            subject=str(bundle.card_path),
            card=str(bundle.card_path.resolve()),
            checkpoint=None if bundle.checkpoint is None else str(bundle.checkpoint.resolve()),
            robot=robot,
            allow_code=allow_code,
        )
    else:
        check_bundle(bundle, get_robot(robot), allow_code=allow_code)


def is_program(adapter: str) -> bool:
    """Whether checkpoints of an adapter have code of their own, be it confined code."""
    return adapter == "torchscript" or adapter.startswith("python:")


def _check(*, card: str, checkpoint: str | None, robot: str, allow_code: bool) -> None:
    bundle = load_bundle(card, checkpoint=None if checkpoint is None else Path(checkpoint))
    check_bundle(bundle, get_robot(robot), allow_code=allow_code)
