"""A first robot.yaml for a model file, from what that says and a drop of 2 s.

It is valid and can be run. Its comments say where each value is from; `CHECK` marks what is a
guess.
"""

from __future__ import annotations

import json
import re
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from nw_base.errors import RobotError, UsageError
from nw_base.files.inside import OutsideError, inside, what_is
from nw_policies.drafting.notation import CHECK, number, plain, quoted, slug
from nw_scenes.robots import BUILT_IN, RobotSpec
from nw_scenes.robots.compiled import Shared
from nw_scenes.robots.derived import ModelFacts, facts_of, spec_of
from nw_scenes.robots.folder import ABSENT, RobotFolder, read_folder
from nw_scenes.robots.kept import notes_of, packed
from nw_scenes.robots.standing import Drop, LevelGround, standing_pose
from nw_sim.probe.robot_check import isolated

_NAMELESS = {"model", "robot", "scene", "urdf", "mjcf", "xml", "main"}
_ROOTS = 3
"""Folders from the model's own upwards that may be the robot's: of URDFs, meshes lie beside."""

# Guesses. Deployed gains of Go1, Go2, B2, G1 and H1 are 0.5 to 1.1 N m / rad for each N m of their
# largest torque, and kd is a 20th to a 50th of kp. Their largest torque at the hip is 0.16 to 0.25
# m times their weight.
_KP_OF_TORQUE, _KD_OF_KP, _TORQUE_OF_WEIGHT = 1.0, 1.0 / 40.0, 0.2
_GRAVITY = 9.806
_NARROW, _WIDE = 0.0873, 12.57  # rad that a joint turns
_FELL = 0.6  # of the height of a biped's root in its pose


@dataclass(frozen=True, kw_only=True)
class DraftedRobot:
    """What a confined process made of a model file."""

    text: str
    """Of robot.yaml."""
    files: tuple[str, ...]
    """Model and meshes, within the folder."""
    stands: bool
    absent: int
    """How many meshes that are only seen are not in the folder."""
    kept: str
    """What the cache keeps of it, as base64."""


def draft_robot(model: Path, *, name: str = "") -> tuple[DraftedRobot, Path]:
    """Return a first robot.yaml for a model file, and the folder that it is for.

    That is the model's own, or one above it that holds its meshes as well.

    Args:
        model: MJCF or URDF.
        name: of the robot; empty = the file's, or the folder's.

    Raises:
        UsageError: there is no such file.
        RobotError: it is no robot that can be driven.
    """
    if what_is(model) != "file":
        raise UsageError(f"there is no file {model}", fix="name an MJCF (.xml) or a URDF (.urdf)")
    refused: dict[tuple[int, bool], list[str]] = {}
    best: tuple[DraftedRobot, Path] | None = None
    for root in _roots(model.resolve()):
        answer = isolated(
            _draft,
            subject=str(model),
            folder=root,
            root=str(root),
            file=model.resolve().relative_to(root).as_posix(),
            name=name,
        )
        try:
            if "refused" in answer:  # A mesh that is not in this folder may be in the one above.
                read, lines = TypeAdapter(tuple[int, list[str]]).validate_python(answer["refused"])
                # The nearest folder of those that say the same, but rather that a file is not there
                # than that it may not be looked for.
                refused.setdefault((read, _ELSEWHERE[0] in lines[0]), lines)
                continue
            drafted = TypeAdapter(DraftedRobot).validate_python(answer)
            for each in drafted.files:
                inside(root, each)
        except (ValidationError, OutsideError, TypeError):
            raise RobotError(f"{model}: the draft cannot be read") from None
        if not drafted.absent:
            return drafted, root
        if best is None or drafted.absent < best[0].absent:
            best = drafted, root  # What is only seen may lie in the folder above, too.
    if best is not None:
        return best
    raise RobotError(refused[max(refused)])  # Of the folder in which most files were found.


_ELSEWHERE = ("is not in the folder", "leaves the folder")


def _roots(model: Path) -> list[Path]:
    """Return the folders that a model's robot may be, the nearest first."""
    above = list(model.parents)[:_ROOTS]
    home = [root for root in above if root.parent != root and root != Path.home()]
    return home or above[:1]


def _draft(*, root: str, file: str, name: str = "") -> dict[str, Any]:
    """Return a draft; or how many files were read, and what was not found after them."""
    seen: dict[str, str] = {}
    try:
        return asdict(_Draft(Path(root), file, seen, name).drafted())
    except RobotError as error:
        if not any(words in str(error) for words in _ELSEWHERE):
            raise
        return {"refused": [len(seen), str(error).splitlines()]}


class _Draft:
    """Makes the lines of a robot.yaml."""

    def __init__(self, root: Path, file: str, seen: dict[str, str], name: str) -> None:
        self.root, self.file, self.seen = root, file, seen
        stem = slug(Path(file).stem)
        own = slug(name) or (slug(root.name) if stem in _NAMELESS or not stem else stem)
        self.named_anew = own in BUILT_IN
        self.name = f"my-{own}" if self.named_anew else own or "robot"
        self.folder = self._read("motors: [{joints: '*'}]")
        self.shared = Shared()
        self.facts: ModelFacts = facts_of(self.folder, self.shared)

    def _read(self, *lines: str) -> RobotFolder:
        self.seen.clear()
        head = ["nw-robot: 1", f"name: {quoted(self.name)}", f"model: {{file: {_file(self.file)}}}"]
        return read_folder(self.root, "\n".join([*head, *lines]) + "\n", self.seen)

    def _spec(self, *lines: str) -> RobotSpec:
        return spec_of(self._read(*lines), self.shared)

    def _ground(self, spec: RobotSpec) -> LevelGround:
        return self.shared.get("ground", lambda: LevelGround(spec)).under(spec)

    def drafted(self) -> DraftedRobot:
        """Return the draft."""
        motors = self._motor_lines()
        first = self._spec("pose: {}", *motors)
        pose, how = self._pose(first)
        spec = self._spec(f"pose: {pose}", *motors)
        dropped = self._dropped(spec)
        lines = [*self._head(), *self._body_lines(spec, dropped, pose, how), *motors]
        lines += [*self._end_lines(spec), *self._left_out()]
        text = "\n".join(lines) + "\n"
        folder = read_folder(self.root, text)
        own = spec_of(folder, self.shared)  # It can be run as it is.
        kept = b64encode(packed(own, notes_of(folder))).decode()
        files = tuple(name for name in folder.files if name != "robot.yaml")
        absent = sum(ABSENT in note for note in folder.notes)
        return DraftedRobot(text=text, files=files, stands=dropped.stands, absent=absent, kept=kept)

    def _dropped(self, spec: RobotSpec) -> Drop:
        return self._ground(spec).drop(held=len(spec.feet) < 3)

    def _head(self) -> list[str]:
        facts = self.facts
        has = f"{facts.bodies} bodies, {len(facts.joints)} driven joints, {facts.mass:.1f} kg"
        note = f"  {CHECK} {self.name[3:]} is built in" if self.named_anew else ""
        return [
            f"# Drafted from {plain(self.file)}: {has}.",
            "# Lines with CHECK are guesses. Then: nw-eval robots check FOLDER",
            "nw-robot: 1",
            f"name: {quoted(self.name)}{note}",
            f"model: {{file: {_file(self.file)}}}",
        ]

    # Its pose.

    def _pose(self, first: RobotSpec) -> tuple[str, str]:
        """Return the pose as YAML, and the comment on it: the first that all its feet carry."""
        ground, held = self._ground(first), len(first.feet) < 3
        feet = ground.bodies_of(first.feet)
        tries = [
            (quoted(key), f"# the keyframe of {plain(self.file)}", self.facts.keyframes[key])
            for key in self._keyframes()
        ]
        own = first.default_pose
        if (bent := standing_pose(first)) is not None:
            guess = f"{CHECK} guessed: legs bent until each foot is under its hip"
            angles = [bent.get(name, at) for name, at in zip(first.joints, own, strict=True)]
            tries.append((_by_pattern(bent, first.joints), guess, tuple(angles)))
        tries.append(("{}", f"{CHECK} no keyframe: zeros, or the nearest in the range", own))
        for pose, how, angles in tries:
            dropped = ground.drop(angles, held=held)
            if dropped.stands and set(feet) <= set(dropped.carriers):
                return pose, how
        pose, _, _ = tries[-2] if bent is not None else tries[-1]
        return pose, f"{CHECK} guessed, and it does not stand: nor does it in any keyframe"

    def _keyframes(self) -> list[str]:
        known = [key for key in self.facts.keyframes if key and len(key) <= 200]
        return sorted(known, key=lambda key: (key != "home", "stand" not in key.lower()))[:4]

    # Its motors.

    def _motor_lines(self) -> list[str]:
        facts, rows = self.facts, list[tuple[str, str]]()
        weight = facts.mass * _GRAVITY
        for i in range(len(facts.joints)):
            torque, kp, kd = facts.torque[i], facts.kp[i], facts.kd[i]
            values, guessed = list[str](), list[str]()
            follows = facts.is_wheel[i] and kp is None
            if follows:
                values.append("follows: velocity")
            if torque is None:
                torque = _rounded(_TORQUE_OF_WEIGHT * weight)
                values.append(f"torque: {number(torque)}")
                guessed.append("torque is 0.2 m of its weight")
            if follows:
                values.append(f"kd: {number(_rounded(_KD_OF_KP * torque))}")
                guessed.append("a wheel, by its shape and range; kd = torque limit / 40 rad/s")
            elif kp is None:
                kp = _rounded(_KP_OF_TORQUE * torque)
                own, kd = kd, kd + _rounded(_KD_OF_KP * kp)
                values += [f"kp: {number(kp)}", f"kd: {number(kd)}"]
                more = f" + the joint's damping of {number(own)}" if own else ""
                text = f"kp = torque limit of {number(torque)} N m / 1 rad, kd = kp / 40 s{more}"
                guessed.append(text)
            rows.append((", ".join(values), "; ".join(guessed)))
        groups: dict[tuple[str, str], list[str]] = {}
        for joint, row in zip(facts.joints, rows, strict=True):
            groups.setdefault(row, []).append(joint)
        said = self._said()
        if set(groups) == {("", "")}:
            # Nothing is missing; where the file has no motors, all hinges are meant.
            return [said, *([] if facts.has_motors else ['motors: [{joints: "*"}]'])]
        lines = [said, "motors:"]
        for (values, guessed), joints in groups.items():
            patterns = _patterns(joints, facts.joints)
            which = json.dumps(patterns[0] if len(patterns) == 1 else patterns)
            if values:
                lines.append(f"  - {{joints: {which}, {values}}}  {CHECK} guessed: {guessed}")
        return lines

    def _said(self) -> str:
        """Return the comment on what the model file says of its motors."""
        facts = self.facts
        said = {
            "kp": [kp for kp in facts.kp if kp is not None],
            "torque": [torque for torque in facts.torque if torque is not None],
            "armature": facts.armature,
            "friction": facts.friction,
            "damping": facts.kd,
        }
        words = [f"{key} {_span(values)}" for key, values in said.items() if values]
        motors = "" if facts.has_motors else ", no motors: all its hinges are driven"
        for one, other in facts.followers.items():
            motors += f"; {plain(one)} follows {plain(other)}"
        return f"# {plain(self.file)} says: {', '.join(words)}{motors}."

    # The rest.

    def _body_lines(self, spec: RobotSpec, dropped: Drop, pose: str, how: str) -> list[str]:
        feet = f"feet: {_names(spec.feet)}"
        idle = [foot for foot in spec.feet if foot not in dropped.carriers]
        if idle:
            comment = f"{CHECK} lowest in the pose; {', '.join(map(plain, idle))} carried nothing"
        else:
            comment = "# what carries it, after 2 s on level ground"
        if len(spec.feet) < 3 and not idle:
            comment += ", held upright"
        return [
            f"root: {quoted(spec.root)}  # the body with the free joint",
            f"{feet}  {comment}",
            f"pose: {pose}  {how}",
            f"# spawn_height: {number(round(spec.spawn_height, 3))}  # m, of that pose; derived",
        ]

    def _end_lines(self, spec: RobotSpec) -> list[str]:
        lines = [f"body: {_names(spec.monitored)}  # whose contact is `collided`: the root"]
        if len(spec.feet) < 3:
            height = round(_FELL * spec.spawn_height, 2)
            lines.append(
                f"fell: {{tilt: 1.2, height: {number(height)}}}  "
                f"{CHECK} guessed: 0.6 of the root's height in the pose"
            )
        else:
            lines.append("fell: {tilt: 1.2, height: null}  # the default")
        lines.append("collided: {force: 0.08}  # of its weight; the default")
        if self.facts.camera is not None:
            file = plain(self.file)
            lines.append(f"# eye: the camera {plain(self.facts.camera)!r} of {file} is it")
        else:
            x = number(round(spec.cameras["ego"].position[0], 3))
            lines.append(
                f"eye: {{position: [{x}, 0, 0], pitch: 0, fovy: 90}}  "
                f"{CHECK} no fixed camera in the file: at the front, looking ahead"
            )
        facts, weight = self.facts, self.facts.mass * _GRAVITY
        widths = [high - low for low, high in spec.joint_ranges]
        for what, doubted in (
            (
                "joints without a range in the file",
                [
                    not (limited or wheel)
                    for limited, wheel in zip(facts.is_limited, facts.is_wheel, strict=True)
                ],
            ),
            (
                "ranges of over two turns or under 5 degrees, as of degrees meant as radians",
                [
                    limited and not (wheel or _NARROW < width < _WIDE)
                    for limited, wheel, width in zip(
                        facts.is_limited, facts.is_wheel, widths, strict=True
                    )
                ],
            ),
            (
                "torque of over 1 m of its weight, as a placeholder is",
                [torque is not None and torque > weight for torque in facts.torque],
            ),
        ):
            names = [plain(name) for name, odd in zip(facts.joints, doubted, strict=True) if odd]
            if names:
                more = f" and {len(names) - 6} more" * (len(names) > 6)
                lines.append(f"{CHECK} {what}: {', '.join(names[:6])}{more}")
        return lines

    def _left_out(self) -> list[str]:
        """Return comments on what of the file is not simulated, or of no effect."""
        account = self.folder.account
        return [
            *(f"{CHECK} not simulated: {plain(each)}" for each in account.sentences()),
            *(
                f"# Of no effect: {plain(', '.join(sorted(what)))}: {reason}"
                for reason, what in account.passed.items()
            ),
        ]


def _names(names: Sequence[str]) -> str:
    return f"[{', '.join(quoted(name) for name in names)}]"


def _file(path: str) -> str:
    return path if re.fullmatch(r"\w[\w./-]*\.[a-z]+", path, re.ASCII) else json.dumps(path)


def _rounded(value: float) -> float:
    """Return a guess with two digits: more would look like knowledge."""
    return float(f"{value:.2g}")


def _span(values: Sequence[float]) -> str:
    low, high = min(values), max(values)
    shown = [f"{value:.4g}" for value in (low, high)]
    return shown[0] if shown[0] == shown[1] else " to ".join(shown)


def _by_pattern(angles: Mapping[str, float], joints: Sequence[str]) -> str:
    """Return angles as YAML, by patterns of names."""
    groups: dict[float, list[str]] = {}
    for joint, angle in angles.items():
        groups.setdefault(angle, []).append(joint)
    pairs = [
        f"{json.dumps(pattern)}: {number(angle)}"
        for angle, names in groups.items()
        for pattern in _patterns(names, joints)
    ]
    return f"{{{', '.join(pairs)}}}"


def _patterns(names: Sequence[str], joints: Sequence[str]) -> list[str]:
    """Return patterns that match some of the joints, and none of the others."""
    if set(names) == set(joints):
        return ["*"]
    others, left, patterns = set(joints) - set(names), list(names), list[str]()
    while left:
        name = left[0]
        # `*_joint`, `*_calf_joint`, and so on: the shortest that matches none of the others.
        cuts = [i for i, letter in enumerate(name) if letter == "_" and i > 0]
        tries = [f"*{name[i:]}" for i in reversed(cuts)]
        fitting = (p for p in tries if not any(fnmatchcase(other, p) for other in others))
        pattern = next(fitting, name)
        patterns.append(pattern)
        left = [one for one in left if not fnmatchcase(one, pattern) and one != pattern]
    return patterns
