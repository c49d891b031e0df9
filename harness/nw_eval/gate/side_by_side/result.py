"""What several policies show side by side: one frozen value that every page renders."""

from __future__ import annotations

from dataclasses import dataclass

from nw_eval.stats import Estimate, Interval
from nw_eval.stats.hazard import HazardDifference
from nw_eval.stats.ranks import Ranks


@dataclass(frozen=True, kw_only=True)
class ComparedPolicy:
    """One policy over all scenes, these weighted equally."""

    label: str
    """What it is called here: the policy's name, and more where two have one name."""
    policy: str
    source: str
    """The run or bank as it was named."""
    mean: float
    """Mean success over its starts."""
    interval: Interval
    """Of mean success for fresh starts, this policy alone: `mean_of_scenes`."""
    completed: int
    """Trials, of those starts, that reached their last waypoint."""
    ranks: Ranks
    """That fresh starts may give it; those of all policies hold together."""


@dataclass(frozen=True, kw_only=True)
class ComparedScene:
    """One scene, over all that was changed in it."""

    scene: str
    starts: int
    """Of each policy."""
    means: tuple[float, ...]
    """Mean success, in the order of the policies."""


@dataclass(frozen=True, kw_only=True)
class ComparedTask:
    """The scenes of one task, these weighted equally."""

    task: str
    scenes: int
    estimates: tuple[Estimate, ...]
    """Success of each policy, as `ComparedPolicy.mean` and `interval`."""


@dataclass(frozen=True, kw_only=True)
class SceneParting:
    """The first waypoint at which a policy parts from the first one."""

    scene: str | None
    """None: all scenes together."""
    policy: int
    """Place of the other policy in the order of the policies."""
    at: HazardDifference
    """`first` is the first policy's hazard."""
    shown: bool
    """Whether it holds with all other waypoints that were looked at. Otherwise it is suspect: this
    waypoint's p alone, of many, is at most 1 - confidence."""


@dataclass(frozen=True, kw_only=True)
class PolicyComparison:
    """Policies side by side, in the order in which they were named."""

    suite: str
    confidence: float
    policies: tuple[ComparedPolicy, ...]
    scenes: tuple[ComparedScene, ...]
    """In alphabetical order."""
    tasks: tuple[ComparedTask, ...]
    """In alphabetical order."""
    partings: tuple[SceneParting, ...]
    """By policy and scene, all scenes together before each; those shown first."""
    waypoints: int
    """That were looked at for partings, over all scenes and policies."""
    shared: bool
    """Whether all have a result from the same starts; else each has as many starts of its own."""
    left_out: int
    """Starts that some policies have a result from, and that are not looked at."""

    @property
    def starts(self) -> int:
        """Of each policy: what every number here is over."""
        return sum(scene.starts for scene in self.scenes)
