"""Trials: their identity, their seeds, and a suite's expansion into all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from hashlib import sha256
from typing import Any, Protocol, cast

import numpy as np

from nw_base.digest import canonical, digest_of
from nw_base.errors import UsageError
from nw_base.plugins import is_measure
from nw_base.words import Tier

MAX_TRIALS = 1_000_000
"""Most trials of one run; more is a typo."""


DrawnStart = tuple[str, tuple[tuple[str, float], ...], int]
"""A scene, a cell of perturbations, and the index of a start."""


class SceneLike(Protocol):
    """What a scene must tell to be part of a trial's identity."""

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def task(self) -> str: ...  # noqa: D102
    @property
    def digest(self) -> str: ...  # noqa: D102


class _GateLike(Protocol):
    def tier(self, scene: str) -> Tier: ...


class _GridLike(Protocol):
    @property
    def cells(self) -> tuple[tuple[tuple[str, float], ...], ...]: ...


class SuiteLike(Protocol):
    """What a suite must tell for all of its trials to be known."""

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def digest(self) -> str: ...  # noqa: D102
    @property
    def seed(self) -> int: ...  # noqa: D102
    @property
    def trials(self) -> int: ...  # noqa: D102
    @property
    def perturb(self) -> _GridLike: ...  # noqa: D102
    @property
    def gate(self) -> _GateLike: ...  # noqa: D102


@dataclass(frozen=True, kw_only=True, slots=True)
class Trial:
    """One seeded rollout, before it is run.

    The identity is (suite digest, scene digest, task, index, perturbation). Names are labels for
    people. The policy is no part of it: two policies meet the same trials.
    """

    suite: str
    suite_digest: str
    suite_seed: int
    scene: str
    scene_digest: str
    task: str
    index: int
    perturbation: tuple[tuple[str, float], ...] = ()
    tier: Tier = "supporting"
    """How much the scene counts, as the suite's gate says; a label, too."""
    place: int | None = None
    """Its place, from 0, in the order that was drawn for a run against a baseline; a label, too.
    None where no order was drawn."""

    @property
    def id(self) -> str:
        """A name that is unique within a run, fit for a file: `hurdles-one_low_carpet-003`."""
        cell = "".join(f"-{axis}_{value!r}" for axis, value in self.perturbation)
        return f"{self.scene.replace('/', '-')}-{self.index:03d}{cell}"

    @property
    def identity(self) -> str:
        """Hex sha256 of the identity."""
        place = _beginning(self.suite_digest, self.scene_digest, self.task)
        cell = canonical(self.perturbation) if self.perturbation else "[]"
        return sha256(f"{place},{self.index},{cell}]".encode()).hexdigest()

    def seed_sequence(self, stream: str = "") -> np.random.SeedSequence:
        """Return the seed sequence of a named random stream of this trial.

        Streams of different names are independent, and asking for one does not move another:
        results do not depend on who asks first.

        Args:
            stream: for example `spawn`, `waypoints`, `policy`, or a sensor's name.
        """
        key = bytes.fromhex(self.identity) + sha256(stream.encode()).digest()
        words = np.frombuffer(key, dtype="<u4")
        return np.random.SeedSequence(
            entropy=self.suite_seed, spawn_key=tuple(int(word) for word in words)
        )

    def generator(self, stream: str) -> np.random.Generator:
        """Return a fresh generator at the start of a named stream."""
        return np.random.Generator(np.random.PCG64(self.seed_sequence(stream)))

    @property
    def seed(self) -> int:
        """The trial's seed as one unsigned 64-bit number, for rows and for policies."""
        return int(self.seed_sequence().generate_state(1, np.uint64)[0])


@lru_cache(maxsize=4096)
def _beginning(suite_digest: str, scene_digest: str, task: str) -> str:
    """Return how the canonical text of an identity begins: the same for all trials of a scene."""
    return canonical([suite_digest, scene_digest, task])[:-1]


def _trial_at(first: Trial, index: int, place: int | None = None) -> Trial:
    """Return another trial of a scene and cell; as `replace`, in a fifth of the time."""
    trial: Trial = object.__new__(Trial)
    for get, put in _SLOTS:
        put(trial, get(first))
    _put_index(trial, index)
    _put_place(trial, place)
    return trial


_put_index, _put_place = (vars(Trial)[name].__set__ for name in ("index", "place"))
_SLOTS = [
    (slot.__get__, slot.__set__) for slot in (vars(Trial)[field.name] for field in fields(Trial))
]


def expand(
    suite: SuiteLike, scenes: Sequence[SceneLike], drawn: Sequence[DrawnStart] | None = None
) -> tuple[Trial, ...]:
    """Return every trial of a suite, interleaved: all scenes' first trials, then the second ones.

    A run that is cut short has so met every scene about equally often.

    Args:
        suite: how many trials in each scene, and what is changed there.
        scenes: the scenes.
        drawn: the trials of a run against a baseline, in their order; as many as `suite.trials`
            in every scene and cell on average. None = trials 0, 1, ... of each.

    Raises:
        UsageError: there are over `MAX_TRIALS`, or two scenes would give trials of one name.
    """
    cells = suite.perturb.cells
    if (total := suite.trials * len(cells) * len(scenes)) > MAX_TRIALS:
        raise UsageError(
            f"suite {suite.name!r} has {total} trials, over {MAX_TRIALS}",
            fix="lower `trials`, or name fewer scenes or perturbations",
        )
    digest = suite.digest
    firsts = [
        Trial(
            suite=suite.name,
            suite_digest=digest,
            suite_seed=suite.seed,
            scene=scene.name,
            scene_digest=scene.digest,
            task=scene.task,
            index=0,
            perturbation=cell,
            tier=suite.gate.tier(scene.name),
        )
        for cell in cells
        for scene in scenes
    ]
    if drawn is None:
        trials = tuple(
            _trial_at(first, round_) for round_ in range(suite.trials) for first in firsts
        )
    else:
        by_stratum = {(first.scene, first.perturbation): first for first in firsts}
        trials = tuple(
            _trial_at(by_stratum[scene, cell], index, place)
            for place, (scene, cell, index) in enumerate(drawn)
        )
    owners: dict[str, str] = {}
    for scene in scenes:
        slug = scene.name.replace("/", "-")
        if slug in owners:
            raise UsageError(
                f"scenes {owners[slug]!r} and {scene.name!r} would both name a trial {slug}-000",
                fix="rename one of them",
            )
        owners[slug] = scene.name
    return trials


_USUAL: dict[str, Any] = {
    "task": {"kind": "course"},
    "render": {"projection": "ewa", "samples": 1, "near": 0.01},
}
"""Settings under which a suite has the digest that it had before it could say them."""


def digest_of_trials(settings: Mapping[str, Any]) -> str:
    """Return the hex sha256 of what decides the course of a suite's trials.

    That is robot, protocol, seed, episode, task, pictures and perturbations, with the versions of
    the packages that have the task or some of their axes. It names trials, so it must not change
    with policy, gate, scores, record, name, scenes or the number of trials: raising `trials` keeps
    the earlier ones, and two policies meet the same ones.

    Args:
        settings: of the suite, as it is written out.
    """
    fields = {name: settings[name] for name in ("robot", "protocol", "seed")}
    # What is not used is left out, so that new axes and switches keep old digests.
    fields["episode"] = {
        name: value
        for name, value in settings["episode"].items()
        if name != "contact_termination" or not value
    }
    fields["perturb"] = {axis: each for axis, each in settings["perturb"].items() if each}
    # What an axis or a task does is a matter of its version. A score changes no trial.
    plugins = cast("Mapping[str, str]", settings.get("plugins") or {})
    if acting := {key: said for key, said in plugins.items() if not is_measure(key)}:
        fields["plugins"] = acting
    for name, usual in _USUAL.items():
        if (said := settings.get(name)) is not None and said != usual:
            fields[name] = said
    if isinstance(task := fields.get("task"), Mapping):
        fields["task"] = without_place(cast("Mapping[str, Any]", task))
    return digest_of(fields)


def without_place(task: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a task without where its motion lies: the file's digest counts."""
    motion = task.get("motion")
    if not isinstance(motion, Mapping):
        return dict(task)
    said = cast("Mapping[str, Any]", motion).items()
    return {**task, "motion": {key: value for key, value in said if key != "file"}}


def cells_of(perturb: Mapping[str, Sequence[float]]) -> tuple[tuple[tuple[str, float], ...], ...]:
    """Return the cells of a grid, axes in alphabetical order; one empty cell without axes."""
    cells: list[tuple[tuple[str, float], ...]] = [()]
    for axis, values in sorted(perturb.items()):
        if values:
            cells = [(*cell, (axis, float(value))) for cell in cells for value in values]
    return tuple(cells)
