"""The two ways to run a trial, as values: one switch for each thing in which they differ.

Suites, jobs, logs and run folders hold the word; whoever runs or reads them looks the value up and
asks its switches, never the word. Sources name the published evaluation: the repository of the
Neverwhere benchmark at commit 5774a18, its task code under `neverwhere/tasks`, and dm_control
1.0.18 and MuJoCo 3.1.6, on which it runs.
"""

from __future__ import annotations

from dataclasses import dataclass

from nw_base.words import Protocol


@dataclass(frozen=True, kw_only=True)
class EvaluationProtocol:
    """How a trial is run."""

    name: Protocol
    """The word for it in a suite."""

    # Where a trial starts.

    one_start_for_all_scenes: bool
    """Trial number i draws from `RandomState(10000 + i)`, in all scenes and whatever the suite's
    seed, and not from a stream of its own. Source: the evaluation loop, which numbers its episodes
    from 10000 and makes each environment with that number; the order of draws is the task's."""

    waypoint_noise_acts: bool
    """Waypoints move by the noise that is drawn for them. Source: the task writes its noise to the
    waypoints' bodies after the reset; those are mocap bodies (scene XML), which the reset has
    placed by then, so that in the first episode of an environment nothing moves."""

    # The physics.

    joint_defaults_act_on_trunk: bool
    """Damping, armature and friction loss of the legs' joints act on the free joint as well: a drag
    of 0.5 N s / m and 0.5 N m s / rad on the trunk (Go2: 0.6). Source: the defaults of joints in
    the robot's XML (`go1/gabe_go1.xml`), under which the free joint stands with the others."""

    fixed_physics_rate: bool
    """The physics takes 200 steps a second, whatever a card asks for. Source: the time step of
    0.005 s in every scene XML, four of them in a control step."""

    reads_forces_of_last_solve: bool
    """Contact forces are what the last solver step left in memory, read at the positions of
    the contacts after it, and so are accelerations; otherwise the solver runs once more. Source:
    dm_control's legacy step, which ends with `mj_step1` and so before any solver; up to 26 N apart
    at touch-down."""

    adds_forces_in_contact_frames: bool
    """Forces of several contacts of a part are added each in its own frame, not in the world's.
    Source: the task's contact force, the norm of the plain sum of contact-frame vectors."""

    # What counts.

    watches_published_geoms: bool
    """The parts whose collision ends a trial are those that the published evaluation can see
    touch: of a Go1 the head alone. Source: the termination's list of geoms, in which `base` is the
    Go1's visual trunk mesh; its collisions are off (`go1/gabe_go1.xml`)."""

    reach_timer_forgets: bool
    """Steps within reach of a waypoint count only while they follow one another. Source: the task's
    timer, which rises within 0.3 m and is set back only when the waypoint is credited."""

    ends_when_stuck: bool
    """A robot that gets no closer to the course's end ends its trial. Source: the published
    termination knows tilt, contact and time only."""

    ends_off_course: bool
    """A robot that leaves the course, or falls through the ground, ends its trial. Source: as for
    `ends_when_stuck`."""

    # What the policy sees.

    fixed_pictures: bool
    """Splats are drawn as gsplat draws them, whatever a suite asks for: by EWA, one sample a pixel,
    from 0.01 m on. Source: `neverwhere/tasks`, which renders by gsplat's `rasterization`."""

    first_step_is_blind: bool
    """Zeros are applied in the first control step and the policy is not asked before it is over.
    Source: the evaluation loop, which steps first, renders in `step` alone, and queues what the
    policy answers then."""

    spoils_first_observation: bool
    """Before the second control step each number of `parkour53` stands eleven times in a row.
    Source: the history wrapper, which repeats each number where it means to repeat the frame, while
    its step counter is below 2."""

    scandots_from_height_image: bool
    """Scandots are read from the pixels of a depth image seen 25 m above the centre of mass.
    Source: the scandots wrapper and the camera `heightmap` of the robot's XML."""


STRICT = EvaluationProtocol(
    name="strict",
    one_start_for_all_scenes=False,
    waypoint_noise_acts=True,
    joint_defaults_act_on_trunk=False,
    fixed_physics_rate=False,
    reads_forces_of_last_solve=False,
    adds_forces_in_contact_frames=False,
    watches_published_geoms=False,
    reach_timer_forgets=True,
    ends_when_stuck=True,
    ends_off_course=True,
    fixed_pictures=False,
    first_step_is_blind=False,
    spoils_first_observation=False,
    scandots_from_height_image=False,
)
"""The published evaluation without its bugs, and without trials that go nowhere."""

NEVERWHERE_2026 = EvaluationProtocol(
    name="neverwhere-2026",
    one_start_for_all_scenes=True,
    waypoint_noise_acts=False,
    joint_defaults_act_on_trunk=True,
    fixed_physics_rate=True,
    reads_forces_of_last_solve=True,
    adds_forces_in_contact_frames=True,
    watches_published_geoms=True,
    reach_timer_forgets=False,
    ends_when_stuck=False,
    ends_off_course=False,
    fixed_pictures=True,
    first_step_is_blind=True,
    spoils_first_observation=True,
    scandots_from_height_image=True,
)
"""The published evaluation, bug for bug."""

PROTOCOLS: dict[str, EvaluationProtocol] = {
    protocol.name: protocol for protocol in (STRICT, NEVERWHERE_2026)
}
"""By their words."""


def protocol_named(name: Protocol) -> EvaluationProtocol:
    """Return the protocol of a suite's word."""
    return PROTOCOLS[name]
