"""Trials: their identity, their seeds, and a suite's expansion into all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from hashlib import sha256
from typing import TYPE_CHECKING, Protocol

import numpy as np

from nw_eval.errors import UsageError
from nw_eval.suite.digest import canonical
from nw_eval.words import Tier

if TYPE_CHECKING:
    from nw_eval.suite.model import Suite


MAX_TRIALS = 1_000_000
"""Most trials of one run; more is a slip of the pen."""


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


def _of(first: Trial, index: int, place: int | None = None) -> Trial:
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
    suite: Suite, scenes: Sequence[SceneLike], drawn: Sequence[DrawnStart] | None = None
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
        trials = tuple(_of(first, round_) for round_ in range(suite.trials) for first in firsts)
    else:
        by_stratum = {(first.scene, first.perturbation): first for first in firsts}
        trials = tuple(
            _of(by_stratum[scene, cell], index, place)
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
