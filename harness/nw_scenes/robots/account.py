"""An account of a robot's model file: what is passed over, and what of it is not simulated.

Each element and attribute of the file is one of these: MuJoCo compiles it; it is of no effect here,
by a table with the reason; it has an effect that is not kept, which drafts and checks name; or it
is refused. `derived` adds what the compiled motors have and a `RobotSpec` has not.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from xml.etree.ElementTree import Element

_WINDOW = "settings of a window"
_MEMORY = "how MuJoCo works, not what it computes"
_LOOKS = "robots are drawn in plain colours"
_ELEMENTS: dict[str, str] = {
    _WINDOW: "statistic mujoco:visual",
    _MEMORY: "size",
    "of muscles": "lengthrange",
    _LOOKS: "texture layer skin",
    "scenes have their own lights": "light",
    "ground of the file; scenes have their own": "hfield",
    "observations are computed from the state": "mujoco:sensor robot:sensor",
    "for a controller of ROS": "transmission ros2_control self_filter calibration verbose",
    "data for other programs": "custom model_state robot:plugin",
    "settings of Gazebo": "gazebo",
}
PASSED = {word: why for why, words in _ELEMENTS.items() for word in words.split()}
"""Elements of no effect here: of MJCF, of URDF, or of other programs in a URDF."""

_ATTRIBUTES: dict[str, str] = {
    "data for other programs": "user",
    "bodies and geoms stay as they are named": "fusestatic discardvisual fuse",
    _LOOKS: "texturedir texrepeat texuniform texcoord texture emission metallic reflectance "
    "roughness shininess specular castshadow normal smoothnormal",
    _MEMORY: "usethread conflict passthrough content_type savecanonical savecompiled saveinertial "
    "simple",
    "bodies do not sleep": "sleep",
    _WINDOW: "ipd output",
    "of delays, which are said": "nsample interp",
    "of muscles": "lengthrange",
}
PASSED_ATTRIBUTES = {word: why for why, words in _ATTRIBUTES.items() for word in words.split()}
"""Attributes of no effect, which are taken off wherever they stand in an MJCF."""

_READ = """robot:name link:name inertial: mass:value inertia:ixx,ixy,ixz,iyy,iyz,izz origin:xyz,rpy
    visual:name collision:name geometry: box:size sphere:radius cylinder:radius,length
    capsule:radius,length mesh:filename,scale material:name color:rgba joint:name,type parent:link
    child:link axis:xyz limit:lower,upper,effort dynamics:damping,friction
    mimic:joint,multiplier,offset mujoco: compiler:* option:*"""
_URDF = {tag: keys.split(",") for tag, _, keys in (each.partition(":") for each in _READ.split())}
"""What MuJoCo reads of a URDF: attributes by element."""
SHAPES = ("box", "sphere", "cylinder", "capsule", "mesh")

_LENS = "focal focalpixel principal principalpixel resolution sensorsize projection"
_LOST: dict[str, str] = {
    "limit velocity": "nothing limits the speed of a joint",
    "safety_controller": "no soft limits act before those of a joint",
    "contact": "MuJoCo reads no contacts of Bullet; friction is 1",
    "joint_properties": "write <dynamics damping=... friction=...>",
    "gazebo": "MuJoCo reads no friction and contacts of Gazebo; friction is 1",
    **dict.fromkeys(
        (f"camera {key}" for key in _LENS.split()),
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
_IDLE = "magnetic jacobian sleep_tolerance sleep energy fwdinv sensor autoreset invdiscrete"
_NO_OPTIONS = frozenset(_IDLE.split())


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

    def update(self, other: Account) -> None:
        """Take what another account of the same file has."""
        self.passed.update(other.passed)
        self.lost.update(other.lost)

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
                self.loses(f"<{tag}>: {_LOST.get(tag, 'it is not an element of URDF')}", line)
                return True
        reason = PASSED.get(f"{root}:{tag}", PASSED.get(tag))
        if reason is not None:
            self.passes(f"<{tag}>", reason)
        return reason is not None

    def attributes(self, element: Element, root: str, line: int) -> None:
        """Account for the attributes of an element that is not left out."""
        tag, read = element.tag, _URDF.get(element.tag, [])
        for key in list(element.attrib):
            if root == "robot" and read != ["*"] and key not in read:
                reason = _LOST.get(f"{tag} {key}")
                if reason is not None:
                    self.loses(f"{key} of <{tag}>: {reason}", line)
                elif key in {"version", "type"} or key.startswith("{"):
                    self.passes(f"{key} of <{tag}>", "data for other programs")
                else:
                    self.loses(f"{key} of <{tag}>: it is not an attribute of URDF", line)
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
