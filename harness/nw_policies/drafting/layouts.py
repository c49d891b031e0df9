"""Published layouts of what policies see, and what their trainings say of motors.

Frames of the body's numbers are from the training code itself, read as data:
leggedrobotics/legged_gym, OpenRobotLab/HIMLoco and fan-ziqi/rl_sar, Genesis-Embodied-AI/Genesis
(examples/locomotion), fan-ziqi/robot_lab, unitreerobotics/unitree_rl_lab, isaac-sim/IsaacLab
(velocity tasks), google-deepmind/mujoco_playground (Go1 joystick).
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

from nw_policies.cards.joints import level_by_level, short_name
from nw_policies.cards.observations import GridOrder

if TYPE_CHECKING:
    from nw_scenes.robots import RobotSpec

Family = Literal["isaac-gym", "isaac-lab", "mujoco"]
"""Simulators whose users export alike."""
_LEGS = ("FL", "FR", "RL", "RR")
_KINDS = ("hip", "thigh", "calf")
LEG_BY_LEG = tuple(f"{leg}_{kind}" for leg in _LEGS for kind in _KINDS)
"""Joints of Unitree's robots in Isaac Gym, which sorts their names."""
TYPE_BY_TYPE = tuple(f"{leg}_{kind}" for kind in _KINDS for leg in _LEGS)
"""The same in Isaac Lab: hips of all legs first."""
RIGHT_FIRST = tuple(f"{leg}_{kind}" for leg in ("FR", "FL", "RR", "RL") for kind in _KINDS)
"""As Unitree's motors are counted."""
_QUADRUPED = len(LEG_BY_LEG)
"""Joints of the robot that the sizes of frames are of."""
_STRAIGHT_HIPS = "{hip: 0, thigh: 0.8, calf: -1.5}"
_CLIPPED = "{term: last_output, clipped: true}"
_LIN_VEL = "{term: lin_vel, scale: 2.0}"
_ANG_VEL = "{term: ang_vel, scale: 0.25}"
_COMMAND = "{term: command, scale: [2.0, 2.0, 0.25]}"
_JOINT_VEL = "{term: joint_vel, scale: 0.05}"
_TWO_FEET = (
    "{term: clock, frequency: 1.5, offsets: [0, 0.5], values: [cosine, sine], "
    "standing: {below: 0.01, phase: 0.5}}"
)


@dataclass(frozen=True, kw_only=True)
class Frame:
    """Terms of one frame, as a card writes them, and who lays them out so."""

    name: str
    """What `init --layout` calls it."""
    source: str
    traits: str
    """What tells it from other layouts of its size."""
    size: int
    terms: tuple[str, ...] = ()
    layout: str | None = None
    """A published layout that stands for the terms."""
    family: Family | None = None
    joints: tuple[str, ...] = ()
    """The order of joints there; empty where it is the robots' own."""
    scale: str = "0.25"
    """rad for each unit of action."""
    pose: str | None = None
    """Default pose; None = the robots' own, which is that of legged_gym."""
    gains: tuple[float, float] | None = None
    """kp, N m/rad, and kd, N m s/rad."""
    clip: float | None = None
    """Limit of raw actions, and of observations after scaling."""
    delay: int = 0
    """Control steps between an action and its effect."""
    history: str = "order: oldest_first, by: term"
    """How frames before the present one stand there, where there are any."""
    steps: int = 1
    """Frames that it is published with."""
    counts: tuple[int, ...] = ()
    """How many frames it is met with; empty = any number up to 20."""
    scan: GridOrder = "x_fastest"
    """Order of a scan of heights behind the frame."""
    scan_scale: float = 1.0
    """Factor of that."""
    any_robot: bool = False
    """Whether robots with other than twelve joints are trained so, too."""

    def with_joints(self, joints: int) -> Frame:
        """Return it for a robot of so many joints, of each of which it has three numbers."""
        if joints == _QUADRUPED:
            return self
        return replace(self, size=self.size + 3 * (joints - _QUADRUPED), joints=(), pose=None)


_GYM = Frame(
    name="legged-gym",
    source="legged_gym",
    traits="velocities times 2, angular ones times 0.25, joint velocities times 0.05; all clipped",
    family="isaac-gym",
    joints=LEG_BY_LEG,
    gains=(20, 0.5),
    clip=100,
    history="order: oldest_first, by: step",
    scan="y_fastest",
    scan_scale=5.0,
    any_robot=True,
    size=48,
    terms=(_LIN_VEL, _ANG_VEL, "gravity", _COMMAND, "joint_pos", _JOINT_VEL, _CLIPPED),
)
_LAB = Frame(
    name="isaac-lab",
    source="Isaac Lab",
    traits="no scales, nothing clipped; joints type by type: four hips, four thighs, four calves",
    family="isaac-lab",
    joints=TYPE_BY_TYPE,
    gains=(25, 0.5),
    any_robot=True,
    size=48,
    terms=("lin_vel", "ang_vel", "gravity", "command", "joint_pos", "joint_vel", "last_output"),
)
FRAMES: tuple[Frame, ...] = (
    Frame(
        name="parkour53",
        source="extreme-parkour, LucidSim",
        traits="heading instead of a velocity command",
        size=53,
        layout="parkour53",
        history="order: oldest_first, by: step",
    ),
    Frame(
        name="playground",
        source="MuJoCo Playground, mjlab",
        traits="the command comes last; no scales; actions times 0.5",
        family="mujoco",
        joints=RIGHT_FIRST,
        scale="0.5",
        pose="{FR_hip: 0.1, FL_hip: -0.1, RR_hip: 0.1, RL_hip: -0.1, thigh: 0.9, calf: -1.8}",
        gains=(35, 0.5),
        size=48,
        terms=("lin_vel", "ang_vel", "gravity", "joint_pos", "joint_vel", "last_output", "command"),
    ),
    _GYM,
    _LAB,
    replace(
        _GYM,
        source="legged_gym without linear velocity",
        size=45,
        terms=_GYM.terms[1:],
    ),
    Frame(
        name="himloco",
        source="HIMLoco, rl_sar",
        traits="the command comes first; scales and clips of legged_gym; six frames, newest first",
        family="isaac-gym",
        joints=LEG_BY_LEG,
        gains=(40, 1),
        clip=100,
        history="order: newest_first, by: step",
        steps=6,
        size=45,
        terms=(_COMMAND, _ANG_VEL, "gravity", "joint_pos", _JOINT_VEL, _CLIPPED),
    ),
    replace(
        _LAB,
        source="Isaac Lab without linear velocity",
        size=45,
        terms=_LAB.terms[1:],
    ),
    Frame(
        name="unitree-rl-lab",
        source="unitree_rl_lab",
        traits="angular velocity times 0.2, joint velocities times 0.05; joints as Isaac Lab",
        family="isaac-lab",
        joints=TYPE_BY_TYPE,
        gains=(25, 0.5),
        any_robot=True,
        size=45,
        terms=(
            "{term: ang_vel, scale: 0.2}",
            "gravity",
            "command",
            "joint_pos",
            _JOINT_VEL,
            "{term: last_output, clip: 100}",
        ),
    ),
    Frame(
        name="robot-lab",
        source="robot_lab",
        traits="scales of legged_gym but for the command, which has none; hips move half as far",
        family="isaac-lab",
        joints=RIGHT_FIRST,
        scale="{hip: 0.125, thigh: 0.25, calf: 0.25}",
        pose=_STRAIGHT_HIPS,
        gains=(25, 0.5),
        size=45,
        terms=(_ANG_VEL, "gravity", "command", "joint_pos", _JOINT_VEL, "last_output"),
    ),
    Frame(
        name="genesis",
        source="Genesis",
        traits="terms of legged_gym, joints right leg first, straight hips, actions one step late",
        family="isaac-gym",
        joints=RIGHT_FIRST,
        pose="{hip: 0, F?_thigh: 0.8, R?_thigh: 1.0, calf: -1.5}",
        gains=(20, 0.5),
        clip=100,
        delay=1,
        history="order: oldest_first, by: step",
        size=45,
        terms=_GYM.terms[1:],
    ),
    Frame(
        name="mjlab",
        source="mjlab without linear velocity",
        traits="the command comes last; no scales; knees bent further; calves move half as far",
        family="mujoco",
        joints=LEG_BY_LEG,
        scale="{hip: 0.335, thigh: 0.335, calf: 0.174}",
        pose="{FL_hip: -0.1, FR_hip: 0.1, RL_hip: -0.1, RR_hip: 0.1, thigh: 0.9, calf: -1.8}",
        size=45,
        terms=("ang_vel", "gravity", "joint_pos", "joint_vel", "last_output", "command"),
    ),
    replace(
        _GYM,
        name="unitree-rl-gym",
        source="unitree_rl_gym",
        traits="legged_gym without linear velocity, and sine and cosine of a phase of 0.8 s",
        counts=(1, 10),  # Five are 235 numbers: Isaac Lab's 48 and 187 heights.
        size=47,
        terms=(*_GYM.terms[1:], "{term: clock, frequency: 1.25}"),
    ),
    Frame(
        name="playground-biped",
        source="MuJoCo Playground's bipeds",
        traits="cosine and sine of the phases of two feet come last; no scales; actions times 0.5",
        family="mujoco",
        scale="0.5",
        any_robot=True,
        counts=(1,),
        size=52,
        terms=(
            *("lin_vel", "ang_vel", "gravity", "command", "joint_pos", "joint_vel", "last_output"),
            _TWO_FEET,
        ),
    ),
)
"""The likelier ones of a size first."""


def isaac_lab_order(robot: RobotSpec) -> tuple[str, ...]:
    """Return the short names of a robot's joints as trainings in Isaac Lab count them.

    Those of Unitree's quadrupeds begin with the left legs, though files of the robots may begin
    with the right ones; others are `level_by_level`.
    """
    own = sorted(map(short_name, robot.joints))
    return TYPE_BY_TYPE if own == sorted(TYPE_BY_TYPE) else level_by_level(robot)


def frames_of(size: int, joints: int = _QUADRUPED) -> tuple[tuple[Frame, int], ...]:
    """Return known frames that make a vector of `size` numbers, with how many of them it takes.

    Those of a robot with other than twelve joints have other sizes.

    Fewer frames come first; among those, layouts that are published with as many.
    """
    of_all = joints == _QUADRUPED
    frames = [frame.with_joints(joints) for frame in FRAMES if of_all or frame.any_robot]
    fits = [(frame, size // frame.size) for frame in frames if size % frame.size == 0]
    fits = [(frame, n) for frame, n in fits if n in (frame.counts or range(1, 21))]
    return tuple(sorted(fits, key=lambda fit: (fit[1], fit[1] != fit[0].steps)))


@dataclass(frozen=True, kw_only=True)
class ScanGuess:
    """A grid of heights, and who measures it so."""

    source: str
    x: int
    """Points ahead."""
    y: int
    """Points to the left."""

    @property
    def size(self) -> int:
        """Points of the grid."""
        return self.x * self.y


ISAAC_LAB = "Isaac Lab"
PARKOUR = ScanGuess(source="extreme-parkour", x=12, y=11)
SCANS: tuple[ScanGuess, ...] = (
    ScanGuess(source=ISAAC_LAB, x=17, y=11),
    PARKOUR,
    ScanGuess(source=ISAAC_LAB, x=21, y=11),
)
TERM_OF: dict[str, tuple[str, int | None]] = {
    **dict.fromkeys(("base_lin_vel", "lin_vel"), ("lin_vel", 3)),
    **dict.fromkeys(("base_ang_vel", "ang_vel", "ang_vel_body"), ("ang_vel", 3)),
    **dict.fromkeys(("projected_gravity", "gravity_vec"), ("gravity", 3)),
    **dict.fromkeys(
        (
            "velocity_commands", "velocity_command", "commands", "command", "twist",
            "generated_commands",
        ),
        ("command", 3),
    ),
    **dict.fromkeys(("joint_pos", "joint_pos_rel", "dof_pos"), ("joint_pos", None)),
    **dict.fromkeys(("joint_vel", "joint_vel_rel", "dof_vel"), ("joint_vel", None)),
    **dict.fromkeys(
        ("actions", "action", "last_action", "last_actions", "prev_actions"), ("last_output", None)
    ),
    "eulerZYX_rpy": ("roll_pitch+yaw", 3),
    **dict.fromkeys(("phase", "gait_phase", "gait_phase_2"), ("clock", 2)),
}  # fmt: skip
"""Names that mjlab, Isaac Lab and rl_sar give to observation terms, with our term and its size;
None = one number for each joint. `+` joins the words of a term that is two of ours."""

_SCAN = re.compile(r"scan|height_?map|elevation|^(measured_|terrain_)?heights$", re.IGNORECASE)
_NO_SCAN = re.compile(r"foot|feet|lidar|laser", re.IGNORECASE)


def is_scan(name: str) -> bool:
    """Return whether an input or a term of this name holds heights of the ground."""
    return bool(_SCAN.search(name)) and not _NO_SCAN.search(name)


def scan_of(size: int) -> ScanGuess | None:
    """Return the known grid of `size` points, or one of similar sides; None where there is none."""
    for scan in SCANS:
        if scan.size == size:
            return scan
    sides = [(size // y, y) for y in range(1, 501) if size % y == 0 and 1 <= size // y <= 500]
    if not sides:
        return None
    x, y = min(sides, key=lambda xy: abs(math.log(xy[0] / xy[1] / 1.5)))
    return ScanGuess(source="a guess", x=x, y=y)


def frames_before_a_scan(
    size: int, joints: int = _QUADRUPED
) -> tuple[tuple[tuple[Frame, int], ...], ScanGuess | None]:
    """Return known frames that make `size` numbers together with a known grid after them.

    Frames of those who measure the grid come first.
    """
    for scan in SCANS:
        if frames := frames_of(size - scan.size, joints):
            return tuple(sorted(frames, key=lambda fit: scan.source not in fit[0].source)), scan
    return (), None
