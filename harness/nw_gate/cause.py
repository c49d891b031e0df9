"""Perception or control: an ablation of old and new perception with old and new control.

Both policies are taken apart by their cards: perception is every sensor of the world around,
control is all the rest. Four policies come of that, which meet the same trials. The drop from old
to new is the sum of two effects in every single trial (Shapley 1953 for two players),

    sight   = 1/2 [y(old, old) - y(old, new) + y(new, old) - y(new, new)]
    control = 1/2 [y(old, old) - y(new, old) + y(old, new) - y(new, new)]

where y(control, sight) is the share of waypoints reached. All three are within [-1, 1] in every
trial. An effect is named where a bettor against "its mean is at most 0" wins (`stats.betting`).
That test errs with at most its level for every distribution with such a mean, also a skewed one,
and for scenes that differ. The drop is tested first. Where neither effect is above 0 the drop is
not either, so that each effect that is tested after a drop was found keeps the level of both
together (closed testing: Marcus, Peritz and Gabriel, Biometrika 63 (1976)).

All trials count, not only those that failed: of trials that are picked for their failure, some end
well in any second try.

A run keeps what its drop is due to in its `cause.json`, for its reports.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from nw_base.errors import StoreError
from nw_base.files.cache import atomic_path
from nw_base.files.inside import regular
from nw_gate.results.row import Row
from nw_gate.stats.betting import lower_bound, p_above, upper_bound
from nw_gate.stats.interval import Interval

Side = Literal["old", "new"]
Arm = tuple[Side, Side]
"""Whose control, and whose perception."""
ARMS: tuple[Arm, ...] = (("old", "old"), ("old", "new"), ("new", "old"), ("new", "new"))

_ONE_NETWORK = (
    "both see through the same sensors, and the checkpoints differ: what a network makes of what "
    "it sees and how it moves cannot be separated by swapping sensors"
)
_NETWORKS = "control is all but the sensors: the networks, too, which differ"
_TOO_FEW = "the new policy is worse, but so few trials leave open which of the two does it"

Answer = Literal["no drop", "perception", "control", "both", "cannot tell"]


@dataclass(frozen=True, kw_only=True)
class ArmScore:
    """What one of the four policies did.

    Attributes:
        whose_control: of the two.
        whose_sight: of the two.
        success: mean share of waypoints over the trials that all four ended.
        completed: of those trials.
        regressed: of the trials that the old one completes and the new one does not.
    """

    whose_control: Side
    whose_sight: Side
    success: float
    completed: int
    regressed: int


@dataclass(frozen=True, kw_only=True)
class Effect:
    """A part of the drop.

    Attributes:
        size: in success, -1 to 1; positive = the new one is worse.
        p: against "it is at most 0"; of a part of the drop, the larger one of its own and the
            drop's.
        interval: of this effect alone; each end errs with probability `Cause.error` at most. None
            in files of earlier versions.
    """

    size: float
    p: float
    interval: Interval | None = None


@dataclass(frozen=True, kw_only=True)
class Apart:
    """In what two policies differ, as their cards and checkpoints say.

    Attributes:
        sight: sensors of the world around, and where cameras sit.
        rest: anything else on the cards: gains, actions, other observations.
        weights: the checkpoints.
    """

    sight: bool
    rest: bool
    weights: bool


@dataclass(frozen=True, kw_only=True)
class Cause:
    """The result.

    Attributes:
        old: the baseline's policy.
        new: the policy that is worse.
        apart: in what they differ.
        trials: that all four policies ended.
        left_out: trials that one of them did not end.
        regressed: trials that the old policy completes and the new one does not.
        arms: old and new control, each with old and new perception.
        drop: from old to new.
        sight: part of the drop that perception causes.
        control: part of the drop that control causes.
        answer: in a word.
        why: in a sentence, what cannot be told and why, or that nothing dropped; empty where all is
            told.
        error: probability of naming an effect that does not exist, at most.
    """

    old: str
    new: str
    apart: Apart
    trials: int
    left_out: int
    regressed: int
    arms: tuple[ArmScore, ...]
    drop: Effect
    sight: Effect
    control: Effect
    answer: Answer
    why: str
    error: float


def cause_of(
    rows: Mapping[Arm, Sequence[Row]],
    apart: Apart,
    *,
    old: str = "old",
    new: str = "new",
    error: float = 0.05,
) -> Cause:
    """Return what a drop is due to.

    Args:
        rows: of the four policies, of the same trials.
        apart: in what the two differ.
        old: name of the one.
        new: name of the other.
        error: see `Cause`.

    Raises:
        ValueError: no trial was ended by all four.
    """
    by_trial = {arm: {row.trial_id: row for row in rows[arm]} for arm in ARMS}
    known = sorted(set.intersection(*(set(of_arm) for of_arm in by_trial.values())))
    names = [n for n in known if all(of_arm[n].success is not None for of_arm in by_trial.values())]
    if not names:
        raise ValueError("no trial was ended by all four")
    y = {arm: _scores([of_arm[name] for name in names]) for arm, of_arm in by_trial.items()}
    done = {
        arm: np.array([bool(of_arm[name].completed) for name in names])
        for arm, of_arm in by_trial.items()
    }
    lost = y["old", "old"] - y["new", "new"]
    crossed = y["new", "old"] - y["old", "new"]
    sight, control = (lost + crossed) / 2.0, (lost - crossed) / 2.0
    drop = _effect(lost, error)
    effects = [_effect(part, error, after=drop.p) for part in (sight, control)]
    fell = done["old", "old"] & ~done["new", "new"]
    answer, why = _answer(drop, effects[0], effects[1], apart, error)
    return Cause(
        old=old,
        new=new,
        apart=apart,
        trials=len(names),
        left_out=len(set.union(*(set(rows) for rows in by_trial.values()))) - len(names),
        regressed=int(fell.sum()),
        arms=tuple(
            ArmScore(
                whose_control=arm[0],
                whose_sight=arm[1],
                success=float(y[arm].mean()),
                completed=int(done[arm].sum()),
                regressed=int((done[arm] & fell).sum()),
            )
            for arm in ARMS
        ),
        drop=drop,
        sight=effects[0],
        control=effects[1],
        answer=answer,
        why=why,
        error=error,
    )


def _effect(parts: NDArray[np.float64], error: float, *, after: float = 0.0) -> Effect:
    """Return the mean of trials' parts; `after` is the p-value of what was tested before."""
    halves, confidence = [(1.0 + parts) / 2.0], 1.0 - error
    return Effect(
        size=float(np.mean(parts)),
        p=max(after, p_above(halves, 0.5)),
        interval=Interval(
            2.0 * lower_bound(halves, confidence) - 1.0, 2.0 * upper_bound(halves, confidence) - 1.0
        ),
    )


def _answer(
    drop: Effect, sight: Effect, control: Effect, apart: Apart, error: float
) -> tuple[Answer, str]:
    if drop.size <= 0.0 or drop.p > error:
        return "no drop", "the new policy is not worse beyond chance: there is nothing to explain"
    if not apart.sight and apart.weights:
        return "cannot tell", _ONE_NETWORK
    named = [effect.p <= error and effect.size > 0.0 for effect in (sight, control)]
    if all(named):
        return "both", ""
    if named[0]:
        return "perception", ""
    if named[1]:
        return "control", _NETWORKS if apart.weights else ""
    return "cannot tell", _TOO_FEW


def _scores(rows: Sequence[Row]) -> NDArray[np.float64]:
    return np.array([row.success for row in rows], np.float64)


_CAUSE = TypeAdapter(Cause)
_LARGEST = 1_000_000  # bytes


def write_cause_file(cause: Cause, path: Path) -> None:
    """Write it, whole or not at all.

    Raises:
        StoreError: it cannot be written.
    """
    with atomic_path(path) as temporary:
        temporary.write_bytes(_CAUSE.dump_json(cause, indent=2) + b"\n")


def read_cause_file(path: Path) -> Cause | None:
    """Read it; None where there is none.

    Raises:
        StoreError: it is damaged.
    """
    try:
        with regular(path).open("rb") as file:
            return _CAUSE.validate_json(file.read(_LARGEST))
    except FileNotFoundError:
        return None
    except (OSError, ValidationError):
        raise StoreError(
            f"{path} is damaged", fix="remove it, or run `nw-eval attribute --cause` again"
        ) from None
