"""What some seconds of a policy showed, as plain values: they travel from a confined process."""

from __future__ import annotations

from dataclasses import dataclass

from nw_eval.onboarding.probe.findings import Finding

FLAT = "flat/carpet_room"
"""The room in which commands and other cards are tried, too."""
BEYOND = (
    "beyond this check: a robot, pose, scale, frame, gain, torque limit, rate or delay that is not "
    "the training's, but with which it walks all the same"
)
"""What no second on the flat can show; said where no fault is found."""


@dataclass(frozen=True, kw_only=True)
class ProbedTerm:
    """The numbers of one term of an observation, or of a whole one without terms."""

    observation: str
    term: str
    numbers: int
    frames: int
    """Of a history, that they fill; 1 without one."""
    form: str
    """Scale, offset and limits as the card has them; empty where nothing is changed."""
    low: float
    mean: float
    high: float
    constant: int
    """How many of the numbers never changed."""


@dataclass(frozen=True, kw_only=True)
class ProbedOutput:
    """The numbers that a network gave which feeds the policy."""

    network: str
    output: str
    numbers: int
    rate: int
    """Hz at which the network is asked."""
    low: float
    mean: float
    high: float
    constant: int


@dataclass(frozen=True, kw_only=True)
class ProbedJoint:
    """What the policy asked of a joint. Targets in rad, or in N m for torques; torque in N m."""

    joint: str
    action_low: float
    action_mean: float
    action_high: float
    target_low: float
    target_high: float
    torque: float
    """The greatest, whichever its sign."""


@dataclass(frozen=True, kw_only=True)
class ProbedCommand:
    """What became of a command. Speeds in `unit`."""

    command: str
    unit: str
    """m/s or rad/s."""
    asked: float
    reached: float
    share: float
    """Reached over asked."""
    fell: bool
    stumbled: bool


@dataclass(frozen=True, kw_only=True)
class ProbeReport:
    """What some seconds of a policy showed, and what is wrong with it."""

    policy: str
    scene: str
    seconds: float
    travelled: float
    """Metres."""
    terms: tuple[ProbedTerm, ...]
    outputs: tuple[ProbedOutput, ...]
    joints: tuple[ProbedJoint, ...]
    """In the policy's order."""
    drives_torque: bool
    """Whether targets are torques."""
    commands: tuple[ProbedCommand, ...]
    findings: tuple[Finding, ...]

    @property
    def faults(self) -> int:
        """How many of the findings are faults."""
        return sum(finding.kind == "fault" for finding in self.findings)

    @property
    def passed(self) -> bool:
        """Whether no fault was found."""
        return not self.faults

    @property
    def caveat(self) -> str:
        """What the check could not show; empty where a fault was found, or off the flat."""
        return BEYOND if self.passed and self.scene == FLAT else ""
