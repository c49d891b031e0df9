"""What the config of a teacher says."""

from __future__ import annotations

from itertools import accumulate
from typing import Annotated, Literal, Self, get_args

from pydantic import AfterValidator, Field, field_validator, model_validator

from nw_base.errors import nearest
from nw_learn.config import ConfigModel, TrainingConfig
from nw_places.splits import split_of
from nw_sim.catalogue import names

Ground = Literal["hurdles", "gaps", "ramps", "stairs", "flat"]
"""What a course asks for; `flat` asks for turns alone."""
GROUNDS: tuple[Ground, ...] = get_args(Ground)

Share = Annotated[float, Field(ge=0.0, le=1.0)]
Weight = Annotated[float, Field(ge=0.0, le=100.0)]


def _known(timestep: float) -> float:
    if timestep not in {0.005, 0.01}:
        raise ValueError(f"a time step of {timestep:g} s is not known; use 0.005 or 0.01")
    return timestep


Timestep = Annotated[float, AfterValidator(_known)]
"""s; a contact's time constant of 0.02 s is two of the longer ones, and no more would do."""


class TaskShares(ConfigModel):
    """Shares of the robots that train on each task; they add up to 1."""

    hurdles: Share
    gaps: Share
    ramps: Share
    stairs: Share
    flat: Share

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if abs(sum(self.of) - 1.0) > 1e-6:
            raise ValueError(f"the shares add up to {sum(self.of):g}; make them 1")
        return self

    @property
    def of(self) -> tuple[float, ...]:
        """The shares in the order of `GROUNDS`."""
        return tuple(getattr(self, ground) for ground in GROUNDS)


class TrainingPhase(ConfigModel):
    """A stretch of the training."""

    share: Annotated[float, Field(gt=0.0, le=1.0)]
    """Of the budget's steps."""
    timestep: Timestep
    """Of the physics, s: 0.01 is faster, 0.005 is what evaluation has."""
    std: Annotated[float, Field(gt=0.0, le=2.0)]
    """Standard deviation of the noise on actions, by which the policy explores."""
    tasks: TaskShares
    scenes: Share = 0.3
    """Share of the episodes that begin in a training scene, not on a random course."""
    learning_rate: Annotated[float, Field(gt=0.0, le=0.1)] | None = None
    """That the phase begins with; the last one's goes on when absent. The divergence of the policy
    from its last version adapts it."""


class PpoSettings(ConfigModel):
    """Proximal policy optimisation (Schulman et al. 2017, arXiv 1707.06347)."""

    robots: int = Field(256, ge=4, le=16384)
    """Simulated side by side."""
    horizon: int = Field(32, ge=2, le=1024)
    """Control steps of each robot between two updates."""
    epochs: int = Field(4, ge=1, le=50)
    minibatches: int = Field(4, ge=1, le=1024)
    clip: float = Field(0.2, gt=0.0, lt=1.0)
    discount: float = Field(0.99, gt=0.0, lt=1.0)
    trace: float = Field(0.95, ge=0.0, le=1.0)
    """Lambda of generalised advantage estimation (arXiv 1506.02438)."""
    divergence: float = Field(0.015, gt=0.0)
    """Kullback-Leibler divergence of an update that the learning rate is adapted to."""
    critic_first: int = Field(8, ge=0)
    """Updates of the critic alone, so that one that knows nothing spoils no policy that does."""

    @model_validator(mode="after")
    def _even(self) -> Self:
        if self.robots * self.horizon % self.minibatches:
            raise ValueError("robots x horizon does not divide into minibatches; choose others")
        return self

    @property
    def samples(self) -> int:
        """Control steps of one update."""
        return self.robots * self.horizon


class CourseSettings(ConfigModel):
    """Random courses: harder by levels, drawn by the generators of the built-in scenes."""

    variants: int = Field(6, ge=1, le=1000)
    """Courses of each task and level that are there at once."""
    levels: int = Field(11, ge=1, le=12)
    """Level 10 has hurdles of 0.36 m, gaps of 0.58 m, slopes of 30 degrees, steps of 0.23 m."""
    start: tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=0)]] = (0, 3)
    """Lowest and highest level that robots begin on."""
    redraw: int = Field(2, ge=0)
    """Updates between two courses that are drawn anew; 0 = never."""
    scenes: tuple[str, ...] | None = None
    """Built-in scenes of the training split to train in (default: all)."""

    @field_validator("scenes")
    @classmethod
    def _for_training(cls, scenes: tuple[str, ...] | None) -> tuple[str, ...] | None:
        known = names("train")
        for name in scenes or ():
            if split_of(name) == "eval":
                raise ValueError(f"{name!r} is kept for evaluation; name scenes to train in")
            if name not in known:
                raise ValueError(f"{name!r} is not a training scene; {nearest(name, known)}")
        return scenes

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        low, high = self.start
        if not low <= high < self.levels:
            raise ValueError(f"start [{low}, {high}] is not within the levels; 0 is the lowest")
        return self


class RewardWeights(ConfigModel):
    """Rewards a second, each times what it names; see `episodes.rewards`."""

    progress: Weight = 1.5
    heading: Weight = 0.5
    turning: Weight = 0.5
    bouncing: Weight = 0.5
    wobbling: Weight = 0.05
    leaning: Weight = 1.0
    jerking: Weight = 2.5e-7
    touching: Weight = 1.0
    changing: Weight = 0.1
    straining: Weight = 5e-5
    spreading: Weight = 0.5
    posing: Weight = 0.04
    edges: Weight = 0.5
    face: Weight = 1.0
    belly: Weight = 0.5
    failing: Weight = 0.5
    """Once, at a failure."""


class TeacherConfig(TrainingConfig):
    """What `nw-eval train teacher` reads."""

    start: Annotated[str, Field(min_length=1)] = "go1-parkour"
    """What the networks begin as: `nothing`, a policy's name or folder (its ONNX weights), or a
    checkpoint (.pt) of an earlier training, critic and levels too."""
    threads: int = Field(1, ge=1, le=256)
    """Of the physics."""
    overlap: bool = True
    """Learn from the last samples while the next ones are collected: two cores, the same curve."""
    ppo: PpoSettings = PpoSettings.model_validate({})
    courses: CourseSettings = CourseSettings.model_validate({})
    rewards: RewardWeights = RewardWeights.model_validate({})
    phases: Annotated[tuple[TrainingPhase, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _whole_budget(self) -> Self:
        total = sum(phase.share for phase in self.phases)
        if abs(total - 1.0) > 1e-6:
            raise ValueError(f"the shares of the phases add up to {total:g}; make them 1")
        return self

    def phase_at(self, step: int) -> int:
        """Return the index of the phase that a step belongs to."""
        ends = accumulate(phase.share * self.budget.steps for phase in self.phases)
        later = (index for index, end in enumerate(ends) if step < end - 0.5)
        return next(later, len(self.phases) - 1)
