"""What the gate of a suite asks of a run, as frozen pydantic models.

A suite file holds it under `gate`; the judgement reads nothing else of a suite.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from fnmatch import fnmatchcase
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)

from nw_base.errors import NwEvalError
from nw_base.files.yaml_file import KEY_LIMIT, is_key
from nw_base.plugins import SCORES, is_elsewhere
from nw_base.words import Tier
from nw_gate.scores import ScoreSpec, specs_of
from nw_gate.scores.score import unusable_range


class Strict(BaseModel):
    """Settings that are read as written: no other keys, no conversions, finite numbers."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class Grown(Strict):
    """Settings that have got fields since they were first written out and digested."""

    came_later: ClassVar[tuple[str, ...]]
    """Those fields: they are written out where they are used."""

    @model_serializer(mode="wrap")
    def _without_what_is_not_used(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out what came later, while it is not used: a suite keeps its digest."""
        fields: dict[str, Any] = write(self)
        for name in self.came_later:
            if getattr(self, name) == type(self).model_fields[name].default:
                fields.pop(name, None)
        return fields


def _key(text: str) -> str:
    """Return a key that a suite file may hold, so that every suite can be saved."""
    if not is_key(text):
        raise ValueError(f"{text[:40]!r} is not a key; use a short printable name")
    return text


KeyPattern = Annotated[str, Field(min_length=1, max_length=KEY_LIMIT), AfterValidator(_key)]


def declared(names: Iterable[str], info: ValidationInfo) -> dict[str, ScoreSpec]:
    """Return the declarations of scores, but for those whose package is installed elsewhere only.

    Raises:
        ValueError: there is no such score, or its package is broken.
    """
    said = (info.context or {}).get("plugins", {})
    own: Mapping[str, ScoreSpec] = (info.context or {}).get("own", {})
    specs = {name: own[name] for name in names if name in own}
    others = [name for name in names if name not in own]
    try:
        return specs | specs_of(name for name in others if not is_elsewhere(SCORES, name, said))
    except NwEvalError as error:
        raise ValueError(str(error)) from None


class Validity(Strict):
    """Where images of a splat still show the scene: near the cameras that it was photographed with.

    A trial in which they do not for longer than `longer_than` in a row has left the captured
    volume, and is counted apart.
    """

    distance: float | None = Field(
        None,
        gt=0.0,
        le=1000.0,
        description="Farthest that the policy's camera may be from the nearest capture camera, m.",
    )
    angle: float | None = Field(
        None,
        gt=0.0,
        le=3.2,
        description="Widest angle between the optical axes of these two, rad.",
    )
    alpha: float | None = Field(
        None,
        gt=0.0,
        lt=1.0,
        description="Least share of an image that the splat must cover.",
    )
    longer_than: float = Field(
        0.5,
        ge=0.0,
        le=600.0,
        description="Longest simulated time in a row beyond any of these, s.",
    )
    at_most: float = Field(
        0.2,
        ge=0.0,
        lt=1.0,
        description="Largest share of trials that may leave the captured volume; with more the "
        "verdict is INCONCLUSIVE.",
    )

    @model_validator(mode="after")
    def _limited(self) -> Self:
        if self.distance is None and self.angle is None and self.alpha is None:
            raise ValueError("validity has no limit; set distance, angle or alpha")
        return self


class ScoreGate(Strict):
    """What one score must show, in its own unit."""

    bar: float | None = Field(
        None,
        description="The mean must reach it, statistically significant; the score declares from "
        "which side.",
    )
    max_drop: float | None = Field(
        None, gt=0.0, description="Change for the worse against the baseline that must not pass."
    )
    tolerate: float | None = Field(
        None,
        ge=0.0,
        description="Equivalence margin: change for the worse that counts as equal; a fifth of "
        "max_drop if None.",
    )
    range: tuple[float, float] | None = Field(
        None,
        description="A narrower range than the score's own, to which its values are clipped: the "
        "narrower, the fewer trials a verdict needs.",
    )

    @model_validator(mode="after")
    def _asks_for_something(self) -> Self:
        if self.bar is None and self.max_drop is None:
            raise ValueError("neither bar nor max_drop is set; set one")
        if self.tolerate is not None and self.tolerate > (self.max_drop or 0.0):
            raise ValueError(f"tolerate {self.tolerate:g} is over max_drop; lower it")
        return self

    @property
    def tolerated(self) -> float:
        """`tolerate`, or a fifth of `max_drop`."""
        return 0.2 * (self.max_drop or 0.0) if self.tolerate is None else self.tolerate

    def spec(self, declared: ScoreSpec) -> ScoreSpec:
        """Return a score's declaration with the range that counts here."""
        return declared if self.range is None else declared.within(*self.range)

    def fault(self, name: str, declared: ScoreSpec) -> str | None:
        """Return what of it does not fit the declaration of its score, or None."""
        if self.range is not None:
            low, high = self.range
            if not declared.low <= low < high <= declared.high:
                return (
                    f"{name}: range {low:g} to {high:g} is not within {declared.low:g} to "
                    f"{declared.high:g}; narrow it"
                )
            if fault := unusable_range(low, high):
                return f"{name}: {fault}"
        spec = self.spec(declared)
        # Nearer to an end, the bar is one with it in the numbers that statistics see.
        if self.bar is not None and not 1e-6 <= spec.scaled(self.bar) <= 1.0 - 1e-6:
            return (
                f"{name}: bar {self.bar:g} is not between {spec.low:g} and {spec.high:g}, the ends "
                "of its range, or too near to one; move it, or narrow `range`"
            )
        if self.max_drop is not None and self.max_drop >= spec.width:
            return f"{name}: max_drop {self.max_drop:g} is as wide as its range; lower it"
        return None


class LadderGate(Strict):
    """What a policy's limit on one ladder must show, in the unit of the ladder's rungs."""

    at_least: float | None = Field(
        None,
        description="Value that the limit must reach, statistically significant; on a ladder whose "
        "values fall, the limit must be at most this.",
    )
    max_drop: float | None = Field(
        None,
        gt=0.0,
        description="Change for the worse against the baseline's limit that must not pass.",
    )
    tolerate: float = Field(
        0.0, ge=0.0, description="Equivalence margin: change for the worse that counts as equal."
    )
    share: float = Field(
        0.5,
        gt=0.0,
        lt=1.0,
        description="A rung is cleared if the policy completes at least this share of its trials "
        "there.",
    )
    trials: int = Field(
        120, ge=1, le=1000, description="Trials of the ladder, at most; then it is INCONCLUSIVE."
    )

    @model_validator(mode="after")
    def _asks_for_something(self) -> Self:
        if self.at_least is None and self.max_drop is None:
            raise ValueError("neither at_least nor max_drop is set; set one")
        if self.tolerate > (self.max_drop or 0.0):
            raise ValueError(f"tolerate {self.tolerate:g} is over max_drop; lower it")
        return self


def tier_of(scene: str, tiers: Mapping[str, Tier]) -> Tier:
    """Return the tier of a scene; its exact name wins over globs, then the first glob."""
    if scene in tiers:
        return tiers[scene]
    for pattern, tier in tiers.items():
        if fnmatchcase(scene, pattern):
            return tier
    return "supporting"


_ROUNDS, _TRIALS = 20, 200
"""Of each scene, and in all, at least: in one scene 20 trials let an equal policy pass in one of
eight gates, 200 in six of seven (tests/gate/stats/baseline/test_few_scenes.py)."""


class Gate(Grown):
    """What a run must show to pass."""

    came_later = ("validity", "claim", "scores", "limits", "rounds", "least_starts")

    success_rate: float | None = Field(
        None,
        ge=1e-6,
        le=1.0 - 1e-6,
        description="Absolute bar: the lower confidence bound of mean success must reach it. "
        "Without one nothing is judged, and the verdict is RAN.",
    )
    baseline: str | None = Field(
        None,
        min_length=1,
        description="Baseline to compare with, `reports/baselines/<suite>/<this>.parquet`, or a "
        "path. It applies to the suite's own `policy`. Another policy is compared with what "
        "--baseline names, or with nothing. --baseline none omits the comparison.",
    )
    max_drop: float | None = Field(
        None,
        gt=0.0,
        lt=1.0,
        description="Drop of mean success against the baseline that must not pass; 0.10 where a "
        "baseline is named and this is not. Without a baseline the bar alone is judged.",
    )
    tolerate: float = Field(
        0.02,
        ge=0.0,
        lt=1.0,
        description="Equivalence margin: a drop against the baseline that counts as equal. "
        "Between it and max_drop "
        "either verdict is legitimate.",
    )
    scene_drop: float = Field(
        0.10,
        ge=0.0,
        lt=1.0,
        description="Drop in one scene that is tolerated; a scene that regressed further is "
        "named, and a critical one alone makes the verdict REGRESSED.",
    )
    rounds: int | None = Field(
        None,
        ge=1,
        le=10_000,
        description="Most trials of each scene against a baseline, on average: scene and initial "
        "state of each trial are drawn at random. The run ends as soon as the verdict is "
        "decided. If absent 20; in a suite of fewer than ten scenes 200 trials in all, and at most "
        "half of the baseline's initial states.",
    )
    least_starts: int = Field(
        30,
        ge=1,
        le=10_000,
        description="Fewest initial states per scene of a baseline for a claim about new initial "
        "states. With fewer than 30, its errors are larger than stated.",
    )
    claim: Literal["fresh", "panel"] = Field(
        "fresh",
        description="Initial states that a comparison with the baseline is about. fresh: new ones "
        "in the same scenes. panel: only the baseline's own, which takes slightly fewer trials "
        "where many of them are used.",
    )
    false_alarm: float = Field(
        0.01,
        gt=0.0,
        le=0.5,
        description="Largest probability that a drop of `tolerate` or less is called REGRESSED.",
    )
    confidence: float = Field(
        0.95,
        ge=0.5,
        le=0.9999,
        description="Confidence of each one-sided bound of the bar. A wrong PASS has at most "
        "probability 1 - confidence, a wrong REGRESSED too, or twice that with critical scenes. "
        "Against a baseline a drop of max_drop passes with at most 1 - confidence.",
    )
    tiers: dict[KeyPattern, Tier] = Field(
        {},
        description="Scene names or globs. The exact name wins, then the first glob; a glob whose "
        "scenes are all covered by earlier ones is an error. critical: must have results; the run "
        "is REGRESSED if its own upper bound is below the bar. supporting (the default): counts in "
        "the mean. informational: is only reported.",
    )
    scores: dict[str, ScoreGate] = Field(
        {},
        description="Scores that are judged beside success, each with `bar`, `max_drop` or both, "
        "in its own unit. All trials of the budget run then.",
    )
    limits: dict[KeyPattern, LadderGate] = Field(
        {},
        description="Ladders on which the policy's limit is judged, by name (`nw-eval scenes "
        "ladders` lists them; a folder with a ladder.yaml is one), each with `at_least`, "
        "`max_drop` or both. Their trials run after those of the scenes.",
    )
    validity: Validity | None = Field(
        None,
        description="Limits beyond which a trial has left the captured volume; such trials are "
        "counted separately. Without limits nothing is checked.",
    )

    @field_validator("scores")
    @classmethod
    def _known_scores(
        cls, gates: dict[str, ScoreGate], info: ValidationInfo
    ) -> dict[str, ScoreGate]:
        if "success" in gates:
            raise ValueError("success is judged by success_rate and max_drop; set those of `gate`")
        for name, spec in declared(gates, info).items():
            if fault := gates[name].fault(name, spec):
                raise ValueError(fault)
        return gates

    @model_validator(mode="after")
    def _ordered_drops(self) -> Self:
        if self.tolerate > self.most_drop:
            most = f"{self.most_drop:g}"
            raise ValueError(f"tolerate {self.tolerate:g} is over max_drop {most}; lower it")
        return self

    @property
    def shared(self) -> int:
        """Over how many scores and limits, success among them, errors of REGRESSED are split."""
        return 1 + len(self.scores) + len(self.limits)

    @property
    def most_drop(self) -> float:
        """`max_drop`, or 0.10 where none is named."""
        return 0.10 if self.max_drop is None else self.max_drop

    def rounds_for(self, scenes: int, starts: int | None = None) -> int:
        """Return the most trials of each scene on average.

        Args:
            scenes: how many there are, each as often as it has cells of perturbations.
            starts: of the baseline in each; None = any. The default beyond 20 is half of them at
                most: with more trials the baseline's own sample decides too much.
        """
        if self.rounds is not None:
            return self.rounds
        wanted = max(_ROUNDS, -(-_TRIALS // max(1, scenes)))
        return wanted if starts is None else min(wanted, max(_ROUNDS, starts // 2), starts)

    def tier(self, scene: str) -> Tier:
        """Return the tier of a scene."""
        return tier_of(scene, self.tiers)
