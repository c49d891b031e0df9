"""One trial as a job and as a result: plain values that travel between processes.

The result says where the trial's time went, by stage.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Literal, Self, get_args

from nw_base.trials import Trial
from nw_base.words import (
    POLICY_FAULTS,
    Backend,
    Collision,
    Fault,
    Kernels,
    Outcome,
    PolicyFault,
    Projection,
    Protocol,
    Record,
    Status,
)
from nw_sim.rendering import PUBLISHED, Rendering
from nw_sim.tasks import COURSE, AnyTask

if TYPE_CHECKING:
    from nw_gate.results.row import Row
    from nw_policies.cards import Card


@dataclass(frozen=True, kw_only=True)
class TrialJob:
    """One trial to run, and where its evidence goes.

    Nothing in it depends on the other trials of the run, on the worker, or on the order.
    """

    trial: Trial
    robot: str  # what robots.get_robot understands
    robot_folder: Path | None = None  # where it lies, if that is a folder
    protocol: Protocol = "strict"
    task: AnyTask = COURSE  # what the robot is to do
    scores: tuple[str, ...] = ()  # what is measured beside
    duration: float  # s of simulated time after which the trial times out
    contact_termination: bool = True  # whether a blow to head or trunk ends it
    scene: str  # what `nw_sim.catalogue.open_scene` understands: a built-in name or a folder
    collision: Collision = "terrain"  # how the mesh of a folder collides
    policy: str  # what policies.load_bundle understands
    policy_name: str = ""  # the bundle's name, by which a replay elsewhere can find it
    checkpoint: Path | None = None  # weights instead of those that the card names
    checkpoint_digest: str  # hex SHA-256; empty = whatever a server serves
    operator: str = ""  # of its networks, that nw-eval does not run: their own runtime does
    allow_code: bool = False  # the caller's word, which no file can give
    record: Record = "failures"  # camera images for which trials; the rest is always logged
    mcap: Path | None = None  # where the log goes; None = no log
    render: Backend = "cpu"  # the renderer of splats
    rendering: Rendering = PUBLISHED  # and how
    time_limit: float = 600.0  # s of wall time after which the trial counts as hung
    attachments: tuple[tuple[str, str], ...] = ()  # (name, text): the suite, the policy's card

    @property
    def also(self) -> tuple[Path, ...]:
        """What it reads beside scene and policy: the robot's folder, and the task's motion."""
        robot = () if self.robot_folder is None else (self.robot_folder,)
        motion = getattr(self.task, "motion", None)
        return robot if motion is None else (*robot, Path(motion.file))


def kernels_of(robot: str, card: Card, *projections: Projection) -> tuple[Kernels, ...]:
    """Return which kernels of the CPU draw what cameras see, run a card's networks, and cast rays.

    A perturbation may bend a lens that the robot's folder says is straight: that takes the time to
    compile, and no more.

    Args:
        robot: what `get_robot` understands.
        card: of the policy that sees it.
        projections: of pinholes; none where nothing is drawn.
    """
    own: tuple[Kernels, ...] = (*(("networks",) if card.needs_executor else ()), "rays")
    if not projections:
        return own
    # Robots of folders are read by the simulator's compiler.
    from nw_policies.cards import mounted_robot
    from nw_scenes.robots import get_robot

    lenses = [mount.intrinsics for mount in mounted_robot(get_robot(robot), card).cameras.values()]
    is_bent = any(lens is not None and lens.distortion is not None for lens in lenses)
    return (*dict.fromkeys(projections), *(("lens",) if is_bent else ()), *own)


Stage = Literal["setup", "physics", "render", "sense", "policy", "log"]


@dataclass(frozen=True, kw_only=True)
class StageSeconds:
    """Seconds that a trial spent in each stage."""

    setup: float = 0.0  # scene, robot, renderer and policy, before the first step
    physics: float = 0.0
    render: float = 0.0  # camera images, the policy's and the log's
    sense: float = 0.0  # every observation that is not an image
    policy: float = 0.0  # its network, and what makes joint targets of its actions
    log: float = 0.0


class StageClock:
    """Adds up the seconds of each stage.

    Stages nest: while an inner one runs, the outer one stands still, so no second counts twice. A
    control step has five of them, and the clock's own time is counted for none: it is short.

    Args:
        clock: returns seconds; `time.thread_time` counts those of the processor alone.
    """

    def __init__(self, clock: Callable[[], float] = perf_counter) -> None:
        stages: tuple[Stage, ...] = get_args(Stage)
        self._clock = clock
        self._spent: dict[Stage, float] = dict.fromkeys(stages, 0.0)
        self._running: list[Stage] = []
        self._began = 0.0

    def __call__(self, stage: Stage) -> Self:
        """Credit the time from now to the end of the `with` block to a stage; only for `with`."""
        now, running = self._clock(), self._running
        if running:
            self._spent[running[-1]] += now - self._began
        running.append(stage)
        self._began = now
        return self

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        now = self._clock()
        self._spent[self._running.pop()] += now - self._began
        self._began = now

    @property
    def stages(self) -> StageSeconds:
        """Seconds so far."""
        return StageSeconds(**self._spent)


@dataclass(frozen=True, kw_only=True)
class TrialResult:
    """One attempt at a trial. An error has no outcome; it says who failed.

    Where the policy itself failed, `end_reason` of the error is how, a `PolicyFault`. That is an
    error until it has happened twice (`engine.rounds`). After an `exit` it is unknown how
    far the trial was: it has reached 0 of 0 waypoints in 0 steps, whatever was reached in truth.

    Digests chain SHA-256 over the control steps: `state_digest` over qpos and qvel,
    `action_digest` over the applied actions, so equal digests mean equal trajectories bit for bit.
    """

    status: Status
    outcome: Outcome | None = None
    end_reason: str = ""  # what decided it: "roll", "contact face", "time", or a PolicyFault
    error_type: Fault | None = None
    error_text: str = ""  # one line

    task_kind: str = "course"
    task_success: float = 0.0  # of a task without waypoints, 0..1
    scores: tuple[tuple[str, float], ...] = ()  # by name, those that are defined

    waypoints_reached: int = 0
    waypoints_total: int = 0
    waypoint_times: tuple[float, ...] = ()  # s of simulated time, one for each reached waypoint
    steps: int = 0  # control steps
    control_rate: float = 50  # control steps in a second, Hz
    sim_seconds: float = 0.0
    contact_s: float = 0.0  # s of simulated time during which head or trunk collided
    coverage_min: float | None = None  # share of a camera image that the splat covers, 0..1
    coverage_mean: float | None = None  # None = no camera image was rendered
    capture_distance: tuple[float, ...] = ()  # of each tenth of a second, as `CapturedViews` has it
    capture_angle: tuple[float, ...] = ()
    capture_alpha: tuple[float, ...] = ()
    state_digest: str = ""  # hex
    action_digest: str = ""  # hex

    wall_seconds: float = 0.0  # all of the trial
    wall: StageSeconds = field(default_factory=StageSeconds)
    mcap_bytes: int = 0  # 0 = no log was kept
    mcap_error: str = ""  # why there is no log, although one was asked for

    @property
    def success(self) -> float:
        """Share of the course's waypoints reached, or what another task scores, 0..1."""
        total = self.waypoints_total
        return self.waypoints_reached / total if total else self.task_success


def policy_fault(ended: TrialResult | Row) -> PolicyFault | None:
    """Return how the policy itself failed in an attempt that ended in an error, or None."""
    if ended.status != "error":
        return None
    return next((fault for fault in POLICY_FAULTS if fault == ended.end_reason), None)


def as_outcome(result: TrialResult) -> TrialResult:
    """Return a policy's own failure as what it is once it has repeated: a result."""
    return replace(result, status="ok", outcome="policy_failed")
