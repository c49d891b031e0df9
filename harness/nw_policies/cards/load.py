"""Cards as files: read, validated, and checked against the robot; which there are.

Errors of a valid card as a whole are reported with their line in the file. Joints are checked
against the robot that the card names; of what feeds what, every name that leads nowhere and every
circle is found.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from pydantic import ValidationError

from nw_base.clean import clean
from nw_base.errors import PolicyError, Problem, UsageError, nearest
from nw_base.files.shipped import available, shipped
from nw_base.files.yaml_file import (
    Location,
    YamlFile,
    YamlProblems,
    json_schema_of,
    parse_yaml,
    read_yaml,
    validation_problems,
)
from nw_policies.cards.card import Card
from nw_policies.cards.feeding import feeding_order, way_back
from nw_policies.cards.joints import (
    PerJoint,
    all_joints,
    held_places,
    joint_actions,
    joint_order,
    joint_values,
    named_joints,
    short_name,
    whole_list,
)
from nw_policies.cards.model import is_whole
from nw_policies.cards.motors import motor_places
from nw_policies.cards.networks import input_parts, listed_inputs, recurrent_fault
from nw_policies.cards.observations import (
    DepthObservation,
    ProprioObservation,
    SemanticsObservation,
    SplatRgbObservation,
)
from nw_policies.cards.terms import FootContacts, check_feet, named_places
from nw_scenes.robots import get_robot

if TYPE_CHECKING:
    from nw_policies.cards.networks import Inputs, Recurrent
    from nw_scenes.robots import RobotSpec

CARD_FILE = "policy.yaml"


# What other stacks call our keys.
_ALSO_CALLED = {
    "action_scale": "scale",
    "damping": "kd",
    "default_joint_angles": "default_pose",
    "default_joint_pos": "default_pose",
    "effort_limits": "torque_limits",
    "joint_names": "joints",
    "latency": "delay_steps",
    "stiffness": "kp",
}


def load_card(path: Path) -> Card:
    """Read a card.

    Raises:
        PolicyError: all problems of the file, one line each, with file, line and column.
    """
    try:
        return _card(read_yaml(path))
    except YamlProblems as error:
        raise PolicyError(error.problems) from None


def parse_card(text: str, *, file: str) -> Card:
    """Read the card of a text, such as the one that a log carries along.

    Args:
        text: what the card's file held.
        file: what errors call it.

    Raises:
        PolicyError: as `load_card`.
    """
    try:
        return _card(parse_yaml(text, file=file))
    except YamlProblems as error:
        raise PolicyError(error.problems) from None


def card_of(values: Mapping[str, Any]) -> Card:
    """Return the card of a mapping with the keys of a card file.

    Raises:
        PolicyError: all problems, one line each.
    """
    places = dict.fromkeys(_locations(values, ()), (1, 1))
    try:
        return _card(YamlFile(path="", data=dict(values), places=places))
    except PolicyError as error:
        name = f"card {clean(values.get('name', ''), at_most=60)!r}"
        raise PolicyError(
            f"{name}: {problem.message}{'' if problem.fix is None else f'; {problem.fix}'}"
            for problem in error.problems
        ) from None


def _card(file: YamlFile) -> Card:
    try:
        card = Card.model_validate(file.data)
    except ValidationError as error:
        problems = validation_problems(error, file, Card, also=_ALSO_CALLED)
        raise PolicyError(problems) from None
    problems = [*joint_problems(card, file), *input_problems(card, file)]
    if problems:
        problems.sort(key=lambda problem: (problem.line, problem.column))
        raise PolicyError(problems)
    return card


def _locations(value: Any, above: Location) -> Iterator[Location]:
    """Yield where everything lies in nested mappings and lists."""
    yield above
    items: Iterable[tuple[Any, Any]] = ()
    if isinstance(value, Mapping):
        items = cast("Mapping[Any, Any]", value).items()
    elif isinstance(value, list | tuple):
        items = enumerate(cast("Sequence[Any]", value))
    for key, item in items:
        yield from _locations(item, (*above, key))


@dataclass(frozen=True, kw_only=True)
class ListedPolicy:
    """A policy that can be asked for by name, as far as its card can be read."""

    name: str
    card: Path
    robot: str = ""
    adapter: str = ""
    title: str = ""
    networks: tuple[str, ...] = ()
    """What feeds the checkpoint, by name."""
    missing: str | None = None
    """Where people get the weights that are not here; empty if the card does not say; None if all
    of them are here."""
    problem: str | None = None
    """The first of what is wrong with the card; then nothing else of it is known."""


def list_cards(search: Path | None = None) -> tuple[ListedPolicy, ...]:
    """Return the shipped bundles, those of the project, and the example cards, by name.

    Args:
        search: the project folder, by default the working directory.
    """
    cards = {name: folder / CARD_FILE for name, folder in available("policies", search).items()}
    examples = shipped("policies") / "examples"
    cards |= {f"examples/{path.parent.name}": path for path in examples.glob(f"*/{CARD_FILE}")}
    return tuple(_listed(name, path) for name, path in sorted(cards.items()))


def _listed(name: str, path: Path) -> ListedPolicy:
    elsewhere = ""
    try:
        card = load_card(path)
    except PolicyError as error:
        faults = [each.message for each in error.problems]
        if not faults or not all(each.startswith(UNKNOWN_ROBOT) for each in faults):
            return ListedPolicy(name=name, card=path, problem=str(error).splitlines()[0])
        # A card of a robot that lies elsewhere says all the rest.
        card, elsewhere = Card.model_validate(read_yaml(path).data), " (robot: not here)"
    named = [network.checkpoint for network in card.networks.values()]
    weights = named if card.checkpoint is None else [card.checkpoint, *named]
    absent = [file for file in weights if not (path.parent / file.file).is_file()]
    return ListedPolicy(
        name=name,
        card=path,
        robot=card.robot,
        adapter=card.adapter,
        title=f"{card.title}{elsewhere}",
        networks=tuple(card.networks),
        missing=(absent[0].source or "") if absent else None,
    )


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a policy card."""
    return json_schema_of(Card)


_NAME = re.compile(r"[A-Za-z_][\w-]{0,63}", re.ASCII)

_NEVER_NEGATIVE = ("kp", "kd", "torque_limits", "armature", "friction_loss", "viscous_friction")
_PER_JOINT = ("scale", "default_pose", *_NEVER_NEGATIVE)


def input_problems(card: Card, file: YamlFile) -> list[Problem]:
    """Return the errors of the inputs of the checkpoint and of its networks, in file order.

    Args:
        card: valid in itself.
        file: that it was read from.
    """
    if card.networks and card.adapter in {"zero", "remote"}:
        text = f"networks: adapter `{card.adapter}` has no checkpoint here that they could feed"
        fix = "remove them; a server has its networks on the card that it serves"
        return [file.problem(("networks",), text, None if card.adapter == "zero" else fix)]
    checked = _Checked(card, file)
    checked.look()
    return sorted(checked.problems, key=lambda problem: (problem.line, problem.column))


class _Checked:
    """The problems of a card's inputs, as they are found."""

    def __init__(self, card: Card, file: YamlFile) -> None:
        self.problems: list[Problem] = []
        self._card = card
        self._file = file
        self._outputs = {name: [*network.given_as(name)] for name, network in card.networks.items()}
        self._known = [*card.observations, *chain.from_iterable(self._outputs.values())]

    def look(self) -> None:
        """Find all of them."""
        card = self._card
        used = self._inputs(("inputs",), card.inputs or {}, card.recurrent, card.adapter)
        for name, network in card.networks.items():
            place = ("networks", name)
            self._names(place, name)
            used |= self._inputs(
                (*place, "inputs"), network.inputs, network.recurrent, network.adapter
            )
            if (fault := recurrent_fault(network.adapter, network.recurrent)) is not None:
                self._tell((*place, "recurrent"), *fault)
            if network.rate is not None and not is_whole(card.control.rate / network.rate):
                text = f"{network.rate} Hz, the policy acts at {card.control.rate} Hz"
                self._tell((*place, "rate"), text, "give a rate that divides it")
        if card.networks and card.inputs is None and not card.adapter.startswith("python:"):
            text = "`inputs` is missing: it names the observations of each input of the checkpoint"
            fix = f"for example `inputs: [{', '.join(self._known)}]`"
            self._tell(("networks",), text, fix, named=False)
        elif card.inputs is not None and used <= set(self._known):
            self._unused(used)  # What is not used is often what a misspelt name meant.
        self._circles()

    def _names(self, place: Location, name: str) -> None:
        """Check what a network and its outputs are called."""
        taken = [one for one in (name, *self._outputs[name]) if one in self._card.observations]
        if taken:
            self._tell(place, f"an observation is called {taken[0]!r}, too", "rename one of them")
        outputs = self._card.networks[name].outputs or {}
        for one, where in ((name, place), *((part, (*place, "outputs", part)) for part in outputs)):
            if not _NAME.fullmatch(one):
                fix = "use letters, digits, '_' and '-', a letter first"
                self._tell(where, f"{one!r} is not a valid name", fix)

    def _inputs(
        self, place: Location, inputs: Inputs, recurrent: Recurrent | None, adapter: str
    ) -> set[str]:
        """Check the inputs of one file; return all that they are made of."""
        used: set[str] = set()
        listed = listed_inputs(inputs)
        for name, parts in input_parts(inputs) if inputs else ():
            where = place if name is None else (*place, name)
            if name in (recurrent or {}):
                self._tell(where, f"{name!r} is in `recurrent` too", "name it in one of them")
            if name in listed:
                where = (*where, "list")
                if adapter != "torchscript":
                    text = f"{name!r} is a list of arrays, which adapter `{adapter}` does not take"
                    self._tell(where, text, "name what is joined to make it: `[...]`")
            if not parts:
                self._tell(where, f"{name!r} has no observations", "name at least one")
            for index, part in enumerate(parts):
                used.add(part)
                if part not in self._known:
                    self._tell((*where, index), *self._unknown(part))
        return used

    def _unknown(self, part: str) -> tuple[str, str]:
        if part in self._outputs:
            text = f"network {part!r} gives {', '.join(self._outputs[part])}"
            return text, "name those that are meant"
        kind = "observation or network" if self._outputs else "observation"
        return f"unknown {kind} {part!r}", nearest(part, self._known)

    def _unused(self, used: set[str]) -> None:
        unused = [name for name in self._card.observations if name not in used]
        if unused:
            text = f"no input uses the observation {', '.join(unused)}"
            self._tell(("observations", unused[0]), text, "use it or remove it", named=False)
        for name, parts in self._outputs.items():
            idle = [part for part in parts if part not in used]
            if idle:
                text = f"no input uses {', '.join(idle)}"
                self._tell(("networks", name), text, "use it or remove it")

    def _circles(self) -> None:
        ordered = feeding_order(self._card)
        for name in self._card.networks:
            if name in ordered or (way := way_back(self._card, name)) is None:
                continue
            text = f"it feeds itself: {' <- '.join(way)}"
            fix = "leave one of them out of `inputs`; a file keeps its own state"
            self._tell(("networks", name, "inputs"), text, fix)
            return  # The others of the circle would say the same.

    def _tell(self, place: Location, text: str, fix: str, *, named: bool = True) -> None:
        parts = [str(part) for part in place if isinstance(part, str)]
        shown = ".".join(parts[:3] if parts[0] == "networks" else parts[:1])
        message = f"{shown}: {text}" if named else text
        self.problems.append(self._file.problem(place, message, fix))


UNKNOWN_ROBOT = "robot: unknown robot"
"""Begins the message of a card whose robot is nowhere to be found."""


def joint_problems(card: Card, file: YamlFile) -> list[Problem]:
    """Return the errors of the robot, the joints and their values, in file order.

    Args:
        card: valid in itself.
        file: that it was read from.
    """
    if "/" in card.robot or ":" in card.robot:
        message = f"robot: {card.robot!r} is not a name, and a card names its robot by name"
        return [file.problem(("robot",), message, "write the `name` of its robot.yaml")]
    try:
        robot = get_robot(card.robot)
    except UsageError as error:
        return [file.problem(("robot",), f"robot: {error.message}", error.fix)]
    own = robot.joints
    faults: list[Problem | None] = [
        *_feet_problems(card, file, robot),
        *_camera_problems(card, file, robot),
        *_reference_problems(card, file, robot),
    ]
    joints = own
    fault = _fault(file, ("control", "held"), lambda: held_places(card.control.held, own))
    faults.append(fault)
    held = None if fault else card.control.held
    if (named := card.control.joints) is not None:
        whole = all_joints(named, held, own)
        order = _fault(file, ("control", "joints"), lambda: joint_order(whole, own))
        faults.append(order)
        joints = own if order else whole
    out = held_places(held, joints)
    driven = [joint for place, joint in enumerate(joints) if place not in out]
    action = card.control.action
    for key in () if isinstance(action, str) else action:
        place = ("control", "action", key)
        faults.append(_fault(file, place, lambda one=key: named_places([one], own, "action")))
    if not any(faults):
        faults.append(_fault(file, ("control", "action"), lambda: joint_actions(action, driven)))
    for key in _PER_JOINT:
        value: PerJoint | None = getattr(card.control, key)
        if value is not None:
            value = whole_list(value, named, [0.0] * len(joints)) if key != "scale" else value
            listed = key == "scale" and isinstance(value, list)
            faults += _value_problems(file, key, value, driven if listed else joints, driven)
    faults.append(_motor_problem(card, file, own))
    if isinstance(held, dict) and not any(faults):
        faults += _range_problems(file, "held", held, joints, robot)
    if (pose := card.control.default_pose) is not None and not any(faults):
        pose = whole_list(pose, named, [0.0] * len(named or ()))
        faults += _range_problems(file, "default_pose", pose, joints, robot)
    problems = [problem for problem in faults if problem is not None]
    return sorted(problems, key=lambda problem: (problem.line, problem.column))


def _motor_problem(card: Card, file: YamlFile, joints: Sequence[str]) -> Problem | None:
    """Return a problem for the first group of motors whose joints the robot does not have."""
    motors = card.control.motors or []
    for number in range(len(motors)):
        place, some = ("control", "motors", number, "joints"), motors[: number + 1]
        if fault := _fault(file, place, lambda groups=some: motor_places(groups, joints)):
            return fault
    return None


def _reference_problems(card: Card, file: YamlFile, robot: RobotSpec) -> Iterator[Problem]:
    """Yield a problem for each body and joint of the motion that the robot does not have."""
    if (reference := card.reference) is None:
        return
    anchor = () if reference.anchor is None else (reference.anchor,)
    for key, names, known in (
        ("anchor", anchor, robot.bodies),
        ("bodies", reference.bodies or (), robot.bodies),
        ("joints", map(short_name, reference.joints or ()), [*map(short_name, robot.joints)]),
    ):
        for index, name in enumerate(names):
            if name not in known:
                place = ("reference", key, *([] if key == "anchor" else [index]))
                text = f"reference.{key}: the robot {robot.name} has no {name!r}"
                yield file.problem(place, text, nearest(name, known))


def _feet_problems(card: Card, file: YamlFile, robot: RobotSpec) -> list[Problem | None]:
    """Return a problem for each term of feet that the robot does not have."""
    return [
        _fault(
            file,
            ("observations", name, "terms", index, "feet"),
            lambda asked=term: check_feet(asked, robot.feet),
        )
        for name, observation in card.observations.items()
        if isinstance(observation, ProprioObservation)
        for index, term in enumerate(observation.terms or ())
        if isinstance(term, FootContacts)
    ]


def _camera_problems(card: Card, file: YamlFile, robot: RobotSpec) -> list[Problem]:
    """Return a problem for each camera that the card names and the robot does not have."""
    named: list[tuple[Location, str]] = [(("cameras", name), name) for name in card.cameras]
    for key, observation in card.observations.items():
        if isinstance(observation, DepthObservation | SemanticsObservation | SplatRgbObservation):
            named.append((("observations", key, "camera"), observation.camera))
    return [
        file.problem(
            place,
            f"{'.'.join(map(str, place))}: {robot.name} has no camera {name!r}",
            nearest(name, robot.cameras),
        )
        for place, name in named
        if name not in robot.cameras
    ]


def _value_problems(
    file: YamlFile, key: str, value: PerJoint, joints: Sequence[str], driven: Sequence[str]
) -> list[Problem | None]:
    place = ("control", key)
    faults: list[Problem | None] = []
    # Where a mapping leaves joints out, the robot's own figures stand; a scale has none.
    default = [None if key == "scale" and joint in driven else 0.0 for joint in joints]
    if isinstance(value, dict):
        for name in value:
            alone = {name: value[name]}
            faults.append(
                _fault(
                    file,
                    (*place, name),
                    lambda one=alone: joint_values(one, joints, [0.0] * len(joints)),
                )
            )
    if not any(faults):
        faults.append(_fault(file, place, lambda: joint_values(value, joints, default)))
    if key in _NEVER_NEGATIVE:
        faults += [
            file.problem(where, f"control.{key}: {number:g} is negative", "give 0 or more")
            for where, number in _numbers(value, place)
            if number < 0.0
        ]
    return faults


def _range_problems(
    file: YamlFile, key: str, pose: PerJoint, joints: Sequence[str], robot: RobotSpec
) -> list[Problem]:
    """Return a problem for each angle of `control` that a joint of its cannot take."""
    ranges = {short_name(j): r for j, r in zip(robot.joints, robot.joint_ranges, strict=True)}
    names = [short_name(joint) for joint in joints]
    problems: list[Problem] = []
    for where, number in _numbers(pose, ("control", key)):
        meant = names
        if isinstance(pose, dict):
            meant = named_joints(str(where[-1]), names)
        elif isinstance(pose, list):
            meant = [names[int(where[-1])]]
        for name in meant:
            low, high = ranges[name]
            if not low <= number <= high:
                message = f"control.{key}: {number:g} is beyond the range of {name}"
                fix = f"give radians from {low:g} to {high:g}, in the robot's own signs"
                problems.append(file.problem(where, message, fix))
                break
    return problems


def _numbers(value: PerJoint, place: Location) -> list[tuple[Location, float]]:
    """Return every number with its place."""
    if isinstance(value, dict):
        return [((*place, name), number) for name, number in value.items()]
    if isinstance(value, list):
        return [((*place, index), number) for index, number in enumerate(value)]
    return [(place, value)]


def _fault(file: YamlFile, place: Location, resolve: Callable[[], object]) -> Problem | None:
    """Return what `resolve` has to object, at a position in the file."""
    try:
        resolve()
    except PolicyError as error:
        key = ".".join(str(part) for part in place[:2])
        return file.problem(place, f"{key}: {error}")
    return None
