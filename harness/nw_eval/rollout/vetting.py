"""Checks a bundle before a run, without ever running a checkpoint's program in this process."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from nw_eval.errors import PolicyError
from nw_eval.policies import Bundle, load_bundle, physics_steps
from nw_eval.robots import get_robot
from nw_eval.rollout.isolated import call_isolated
from nw_eval.sensors import check_bundle, check_card


def vet_bundle(
    bundle: Bundle, robot: str, *, protocol: str = "strict", allow_code: bool = False
) -> Bundle:
    """Check a card against robot, protocol and checkpoint.

    Checkpoints that are programs (TorchScript, Python) are opened in a process of their own.

    Returns:
        The bundle; a remote one with the digest of what its server says that it serves.

    Raises:
        PolicyError: as `sensors.check_bundle`; or the card does not fit the protocol, or what is
            served.
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
        return bundle
    if bundle.card.adapter == "remote":
        bundle = _asked(bundle, robot, allow_code=allow_code)
    check_bundle(bundle, get_robot(robot), allow_code=allow_code)
    return bundle


def is_program(adapter: str) -> bool:
    """Whether checkpoints of an adapter have code of their own, be it confined code."""
    return adapter == "torchscript" or adapter.startswith("python:")


def _asked(bundle: Bundle, robot: str, *, allow_code: bool) -> Bundle:
    """Return a remote bundle with the digest of what is served, which takes what the card makes."""
    from nw_eval.policies.adapters.remote import ask_server  # Not everybody has websockets.

    code_from = bundle.folder if allow_code else None
    specs = check_card(bundle.card, get_robot(robot), code_from=code_from)
    served = ask_server(bundle)
    for spec in specs:
        wanted = served.shapes.get(spec.name, spec.shape)
        if wanted != spec.shape:
            raise PolicyError(
                f"{bundle.card_path}: `{spec.name}` is {_size(spec.shape)} numbers; on the served "
                f"card it is {_size(wanted)}",
                fix=f"the card makes {spec.reckoning}; copy `observations` from the served card",
            )
    return replace(bundle, checkpoint_sha256=served.digest)


def _size(shape: tuple[int, ...]) -> str:
    return " x ".join(str(side) for side in shape)


def _check(*, card: str, checkpoint: str | None, robot: str, allow_code: bool) -> None:
    bundle = load_bundle(card, checkpoint=None if checkpoint is None else Path(checkpoint))
    check_bundle(bundle, get_robot(robot), allow_code=allow_code)
