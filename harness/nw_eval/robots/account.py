"""An account of a robot's model file: what is passed over, and what of it is not simulated.

Each element and attribute of the file is one of these: MuJoCo compiles it; it is of no effect here,
by a table with the reason; it has an effect that is not kept, which drafts and checks name; or it
is refused. `derived` adds what the compiled motors have and a `RobotSpec` has not.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from xml.etree.ElementTree import Element

_WINDOW = "settings of a window"
_MEMORY = "how MuJoCo works, not what it computes"
_OWN_SENSORS = "observations are computed from the state"
_LOOKS = "robots are drawn in plain colours"
_CONTROLLER = "for a controller of ROS"

PASSED: dict[str, str] = {
    **dict.fromkeys(("statistic", "mujoco:visual"), _WINDOW),
    **dict.fromkeys(("size", "lengthrange"), _MEMORY),
    **dict.fromkeys(("texture", "layer", "skin"), _LOOKS),
    "custom": "data for other programs",
    "light": "scenes have their own lights",
    "hfield": "ground of the file, in place of which scenes have their own",
    "mujoco:sensor": _OWN_SENSORS,
    "robot:sensor": _OWN_SENSORS,
    **dict.fromkeys(("transmission", "ros2_control", "self_filter"), _CONTROLLER),
    **dict.fromkeys(("calibration", "verbose"), _CONTROLLER),
    **dict.fromkeys(("model_state", "robot:plugin"), "data for other programs"),
    "gazebo": "settings of Gazebo",
}
"""Elements of no effect here: of MJCF, of URDF, or of other programs in a URDF."""

PASSED_ATTRIBUTES: dict[str, str] = {
    "user": "data for other programs",
    **dict.fromkeys(
        ("fusestatic", "discardvisual", "fuse"), "bodies and geoms stay as they are named"
    ),
    **dict.fromkeys(("texturedir", "texrepeat", "texuniform", "texcoord", "texture"), _LOOKS),
    **dict.fromkeys(("emission", "metallic", "reflectance", "roughness", "shininess"), _LOOKS),
    **dict.fromkeys(("specular", "castshadow", "normal", "smoothnormal"), _LOOKS),
    **dict.fromkeys(("usethread", "conflict", "passthrough", "content_type"), _MEMORY),
    **dict.fromkeys(("savecanonical", "savecompiled", "saveinertial", "simple"), _MEMORY),
    "sleep": "bodies do not sleep",
    **dict.fromkeys(("ipd", "output"), _WINDOW),
    **dict.fromkeys(("nsample", "interp"), "of delays, which are said"),
    "lengthrange": "of muscles",
}
"""Attributes of no effect, which are taken off wherever they stand in an MJCF."""

_URDF: dict[str, str] = {
    "robot": "name",
    "link": "name",
    "inertial": "",
    "mass": "value",
    "inertia": "ixx ixy ixz iyy iyz izz",
    "origin": "xyz rpy",
    "visual": "name",
    "collision": "name",
    "geometry": "",
    "box": "size",
    "sphere": "radius",
    "cylinder": "radius length",
    "capsule": "radius length",
    "mesh": "filename scale",
    "material": "name",
    "color": "rgba",
    "joint": "name type",
    "parent": "link",
    "child": "link",
    "axis": "xyz",
    "limit": "lower upper effort",
    "dynamics": "damping friction",
    "mimic": "joint multiplier offset",
    "mujoco": "",
    "compiler": "*",
    "option": "*",
}
"""What MuJoCo reads of a URDF: attributes by element."""
SHAPES = ("box", "sphere", "cylinder", "capsule", "mesh")

_LOST: dict[str, str] = {
    "limit velocity": "nothing limits the speed of a joint",
    "safety_controller": "no soft limits act before those of a joint",
    "contact": "MuJoCo reads no contacts of Bullet; friction is 1",
    "joint_properties": "write <dynamics damping=... friction=...>",
    "gazebo": "MuJoCo reads no friction and contacts of Gazebo; friction is 1",
    **dict.fromkeys(
        [f"camera {key}" for key in "focal focalpixel principal principalpixel resolution".split()]
        + ["camera sensorsize", "camera projection"],
        "only its vertical field of view is taken; write `intrinsics` in robot.yaml",
    ),
    "camera mode": "a camera that follows something is none of the robot's",
}
_GAZEBO = {"mu", "mu1", "mu2", "kp", "kd", "surface", "ode", "physics"}  # that act on contacts

OWN_OPTIONS: dict[str, str] = {
    "timestep": "0.005",
    "gravity": "0 0 -9.806",
    "integrator": "Euler",
    "cone": "pyramidal",
    "solver": "Newton",
    "iterations": "50",
    "tolerance": "1e-8",
    "impratio": "1",
}
"""With which all robots are simulated, so that their scores compare. The rest is MuJoCo's own."""
_NO_OPTIONS = frozenset(
    "magnetic jacobian sleep_tolerance sleep energy fwdinv sensor autoreset invdiscrete".split()
)


@dataclass
class Account:
    """What a reader of a robot's file did not take.

    Attributes:
        passed: what is of no effect, by reason.
        lost: the lines where something with an effect stands, by a sentence on it.
    """

    passed: dict[str, dict[str, None]] = field(default_factory=dict[str, dict[str, None]])
    lost: dict[str, list[int]] = field(default_factory=dict[str, list[int]])

    def passes(self, what: str, why: str) -> None:
        """Pass over something of no effect."""
        self.passed.setdefault(why, {})[what] = None

    def loses(self, sentence: str, line: int = 0) -> None:
        """Say that something with an effect is not simulated."""
        self.lost.setdefault(sentence, []).append(line)

    def sentences(self) -> list[str]:
        """Return what is not simulated, with the line where it stands first."""
        return [
            sentence
            + (f"; line {min(lines)}" if min(lines) else "")
            + (f" and {len(lines) - 1} more" if len(lines) > 1 and min(lines) else "")
            for sentence, lines in self.lost.items()
        ]

    def leaves_out(self, element: Element, root: str, line: int) -> bool:
        """Return whether an element is left out, and account for it.

        Args:
            element: below the root of a model file.
            root: tag of that root, `mujoco` or `robot`.
            line: where it stands.
        """
        tag = element.tag
        if tag.startswith("{") and "xacro" in tag:
            self.passes(f"<xacro:{tag.partition('}')[2]}>", "nothing uses it")
            return True
        if tag == "option":
            self._options(element, line)
            return True
        heavy = tag == "gazebo" and any(each.tag in _GAZEBO for each in element.iter())
        if root == "robot" and (tag in _LOST or tag not in _URDF) and tag != "texture":
            reason = PASSED.get(f"robot:{tag}", PASSED.get(tag))
            if reason is None or heavy:
                self.loses(f"<{tag}>: {_LOST.get(tag, 'it is no element of URDF')}", line)
                return True
        reason = PASSED.get(f"{root}:{tag}", PASSED.get(tag))
        if reason is not None:
            self.passes(f"<{tag}>", reason)
        return reason is not None

    def attributes(self, element: Element, root: str, line: int) -> None:
        """Account for the attributes of an element that is not left out."""
        tag, read = element.tag, _URDF.get(element.tag, "").split()
        for key in list(element.attrib):
            if root == "robot" and read != ["*"] and key not in read:
                reason = _LOST.get(f"{tag} {key}")
                if reason is not None:
                    self.loses(f"{key} of <{tag}>: {reason}", line)
                elif key in {"version", "type"} or key.startswith("{"):
                    self.passes(f"{key} of <{tag}>", "data for other programs")
                else:
                    self.loses(f"{key} of <{tag}>: it is no attribute of URDF", line)
            elif root == "mujoco" and f"{tag} {key}" in _LOST and element.get(key) != "fixed":
                self.loses(f"{key} of <{tag}>: {_LOST[f'{tag} {key}']}", line)
            elif root == "mujoco" and (
                key in PASSED_ATTRIBUTES or (key == "group" and tag != "geom")
            ):
                self.passes(f"{key} of <{tag}>", PASSED_ATTRIBUTES.get(key, _WINDOW))
                del element.attrib[key]

    def _options(self, option: Element, line: int) -> None:
        flags = {k: v for each in option for k, v in each.attrib.items()}
        other = [
            f'{key}="{value[:40]}"'
            for given, own in ((option.attrib, OWN_OPTIONS), (flags, {}))
            for key, value in given.items()
            if key not in _NO_OPTIONS and not _same(value, own.get(key, ""))
        ]
        for key in _NO_OPTIONS & {*option.attrib, *flags}:
            self.passes(f"{key} of <option>", _MEMORY)
        if other:
            own = " ".join(f'{key}="{value}"' for key, value in OWN_OPTIONS.items())
            self.loses(f"<option {' '.join(other)}>: all robots are simulated with {own}", line)


def _same(one: str, other: str) -> bool:
    try:
        return list(map(float, one.split())) == list(map(float, other.split()))
    except ValueError:
        return one == other


def unexpanded(root: Element) -> str | None:
    """Return what of a URDF only xacro can read; None = nothing."""
    for element in root.iter():
        if re.search(r"\{.*xacro.*\}(?!property$|arg$|macro$)", element.tag):
            return f"<xacro:{element.tag.partition('}')[2]}>"
        for key, value in element.attrib.items():
            if "${" in value or ("$(" in value and key != "filename"):
                return f'{key}="{value[:60]}"'
    return None


