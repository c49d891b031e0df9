"""Checks a bundle before a run, without ever opening its checkpoint in this process."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_base.errors import PolicyError
from nw_base.protocol import STRICT, EvaluationProtocol
from nw_policies import Bundle, load_bundle
from nw_policies.cards import mounted_robot, physics_steps
from nw_policies.planned import operator_of
from nw_scenes.robots import RobotSpec, find_robot, get_robot, know_robot
from nw_sim.rollout.confined.access import opening_rules, policy_rules, running_rules
from nw_sim.rollout.confined.isolated import TIME_LIMIT, IsolatedCall
from nw_sim.rollout.confined.start import prepare_for, prepare_kernels

if TYPE_CHECKING:
    from nw_sim.sensors.build import ObservationSpec
    from nw_sim.tasks.track import Motion


def vet_bundle(
    bundle: Bundle,
    robot: str,
    *,
    protocol: EvaluationProtocol = STRICT,
    allow_code: bool = False,
    may_fail: bool = False,
) -> Bundle:
    """Check a card against robot, protocol and checkpoint.

    Checkpoints, and Python code, are opened in a confined process. `may_fail` is as for
    `check_bundle`.

    Returns:
        The bundle; a remote one with the digest of what its server says that it serves. Where its
        card leaves the choice of what runs it, and nw-eval lacks an operator, its card says so.

    Raises:
        PolicyError: as `check_bundle`; or the card does not fit the protocol, or what is
            served.
    """
    physics_steps(bundle.card, protocol)
    if bundle.card.adapter == "remote":
        bundle = _with_server(bundle, robot, allow_code=allow_code)
    if bundle.checkpoint is None and not bundle.code_sha256 and not bundle.motors:
        # There is no untrusted file to open but the card, and a server was asked already.
        check_bundle(bundle, get_robot(robot), allow_code=allow_code, may_fail=may_fail)
        return bundle
    prepare_for(bundle.card)
    folder = find_robot(robot).folder
    arguments = {
        "card": bundle.reference,
        "checkpoint": None if bundle.checkpoint is None else str(bundle.checkpoint.resolve()),
        "robot": robot,
        "robot_folder": None if folder is None else str(folder),
        "allow_code": allow_code,
        "may_fail": may_fail,
    }
    with IsolatedCall(
        _check,
        subject=bundle.where,
        rules=opening_rules(
            bundle, allow_code=allow_code, also=() if folder is None else (folder,)
        ),
        renders=(),
        policy=policy_rules(bundle) if bundle.python is not None and allow_code else None,
        arguments=arguments,
    ) as call:
        prepare_kernels()  # Trials may want them, and this process does not.
        operator = call.answer(TIME_LIMIT)
    return bundle.by_its_own_runtime(operator)


def vet_motion(bundle: Bundle, robot: str, named: Motion | None = None) -> None:
    """Put the motion of a suite or of a card on its robot in a confined process, as trials will.

    Args:
        bundle: of the policy, whose card says anchor and bodies.
        robot: its name.
        named: the suite's motion, with an absolute path; None = the card's.

    Raises:
        PolicyError: the file is no motion, is damaged, or is of another robot.
    """
    folder = find_robot(robot).folder
    files = [None if named is None else Path(named.file), folder]
    with IsolatedCall(
        _fit_motion,
        subject=bundle.where if named is None else named.file,
        rules=running_rules(bundle, scenes=(), also=[path for path in files if path is not None]),
        renders=(),
        arguments={
            "card": bundle.reference,
            "checkpoint": None if bundle.checkpoint is None else str(bundle.checkpoint.resolve()),
            "robot": robot,
            "robot_folder": None if folder is None else str(folder),
            "named": None if named is None else named.model_dump(mode="json"),
        },
    ) as call:
        call.answer(TIME_LIMIT)


def _fit_motion(
    *,
    card: str,
    checkpoint: str | None,
    robot: str,
    robot_folder: str | None,
    named: dict[str, Any] | None,
) -> None:
    from nw_sim.rollout.referenced import reference_of
    from nw_sim.survey.course import flat_world
    from nw_sim.tasks.track import Motion

    know_robot(robot, None if robot_folder is None else Path(robot_folder))
    bundle = load_bundle(card, checkpoint=None if checkpoint is None else Path(checkpoint))
    motion = None if named is None else Motion.model_validate(named)
    own = mounted_robot(get_robot(robot), bundle.card)
    with flat_world(own, physics_steps(bundle.card, STRICT)) as world:
        reference_of(bundle, world, bundle.card, motion)


def _with_server(bundle: Bundle, robot: str, *, allow_code: bool) -> Bundle:
    """Return a remote bundle with the digest of what is served, which takes what the card makes."""
    from nw_policies.remote import ask_server  # Not everybody has websockets.
    from nw_sim.sensors import check_card

    code_from = bundle.folder if allow_code else None
    card = bundle.card_path
    specs = check_card(bundle.card, get_robot(robot), where=card, code_from=code_from)
    served = ask_server(bundle)
    for spec in specs:
        wanted = served.shapes.get(spec.name, spec.shape)
        if wanted != spec.shape:
            raise PolicyError(
                f"{bundle.where}: `{spec.name}` is {_size(spec.shape)} numbers; on the served "
                f"card it is {_size(wanted)}",
                fix=f"the card makes {spec.reckoning}; copy `observations` from the served card",
            )
    return replace(bundle, checkpoint_sha256=served.digest)


def _size(shape: tuple[int, ...]) -> str:
    return " x ".join(str(side) for side in shape)


def _check(
    *,
    card: str,
    checkpoint: str | None,
    robot: str,
    robot_folder: str | None,
    allow_code: bool,
    may_fail: bool,
) -> str:
    know_robot(robot, None if robot_folder is None else Path(robot_folder))
    bundle = load_bundle(card, checkpoint=None if checkpoint is None else Path(checkpoint))
    check_bundle(bundle, get_robot(robot), allow_code=allow_code, may_fail=may_fail)
    return operator_of(bundle)


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
            wants another number of values than the card makes, or fails on zeros; a network of
            motors cannot be read.
    """
    # Sensors know the simulator, for which the process that vets a bundle may have no use.
    from nw_policies.trying import ShownInput, try_bundle
    from nw_sim.rollout.driven import drives_of, programs_of
    from nw_sim.sensors.build import check_card

    code_from = bundle.folder if allow_code else None
    specs = check_card(bundle.card, robot, where=bundle.card_path, code_from=code_from)
    shown = [ShownInput(spec.name, spec.shape, spec.dtype.str, spec.reckoning) for spec in specs]
    for _ in drives_of(bundle.card, robot or get_robot(bundle.card.robot), programs_of(bundle)):
        pass  # Reading it is the check.
    try_bundle(bundle, shown, allow_code=allow_code, may_fail=may_fail, seconds=seconds)
    return specs
