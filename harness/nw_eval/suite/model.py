"""What a suite file says, as frozen pydantic models; what a request may change of it for one run.

`load.py` reads suites from YAML. `json_schema` is for editors that complete and check YAML as one
types.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from math import prod
from pathlib import Path
from typing import Annotated, Any, Literal, Self, cast

from pydantic import (
    AfterValidator,
    Field,
    PrivateAttr,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from nw_base.digest import digest_of
from nw_base.errors import NwEvalError, Problem, UsageError
from nw_base.files.yaml_file import explain_limit
from nw_base.plugins import AXES as GROUP
from nw_base.plugins import (
    SCORES,
    TASKS,
    key_of,
    version_named,
    version_of,
    warn_if_built_in,
)
from nw_base.protocol import protocol_named
from nw_base.trials import digest_of_trials
from nw_base.words import Protocol, Record
from nw_gate.results.request import Request
from nw_gate.scores import BUILT_IN as SCORE_CLASSES
from nw_gate.scores import ScoreSpec, specs_of
from nw_gate.scores.own import (
    EXPECT,
    Expectation,
    OwnScore,
    expectation_spec,
    expectation_text,
    own_text,
    source_digest,
)
from nw_gate.settings import Gate, Grown, Strict, declared
from nw_sim.axes import AXES, Perturb, each_once
from nw_sim.rendering import PUBLISHED, Rendering
from nw_sim.tasks import BUILT_IN as TASK_CLASSES
from nw_sim.tasks import COURSE, AnyTask, declared_by, declared_by_kind

MAX_CELLS = 10_000
"""Most cells that a perturbation grid may have: a longer one is a typo."""


@dataclass(frozen=True, kw_only=True)
class Source:
    """The file that a suite was read from, and where its settings stand: `(line, column)`.

    Two suites that say the same are equal wherever they were written, so no field is compared.
    """

    file: str = field(default="<suite>", compare=False)
    folder: Path | None = field(default=None, compare=False)  # where it is, if `file` cannot say
    places: Mapping[tuple[str | int, ...], tuple[int, int]] = field(
        default_factory=dict, compare=False
    )

    @property
    def base(self) -> Path:
        """The folder that relative scene and policy paths of the file start from."""
        return Path(self.file).parent if self.folder is None else self.folder

    def problem(self, location: tuple[str | int, ...], message: str, fix: str | None) -> Problem:
        """Return a problem at a setting, or at the nearest one around it that the file has."""
        while location and location not in self.places:
            location = location[:-1]
        line, column = self.places.get(location, (1, 1))
        return Problem(file=self.file, line=line, column=column, message=message, fix=fix)


Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
Pattern = Annotated[str, Field(min_length=1, max_length=1024)]
Patterns = Annotated[tuple[Pattern, ...], Field(min_length=1), AfterValidator(each_once)]


class EpisodeRules(Strict):
    """What ends a trial, besides its last waypoint and a fall."""

    duration: float = Field(
        12.0, gt=0.0, le=600.0, description="Longest simulated time of a trial, s."
    )
    contact_termination: bool = Field(
        True,
        description="Whether a blow to head or trunk (10 N) ends a trial as collided; false only "
        "counts its seconds.",
    )


class Suite(Grown):
    """A suite: which robot meets which scenes, how often, and what it must show."""

    came_later = ("task", "render", "scores", "expect", "plugins")

    version: Literal[1] = Field(alias="nw-eval", description="Version of this format.")
    name: Name = Field(description="The suite's name: letters, digits, '_', '-', '.'.")
    robot: Annotated[str, Field(min_length=1, max_length=1024)] = Field(
        description="The robot: go1, go2, the name of one in robots/ or of a package, the path "
        "of a robot's folder, hub:org/name[@revision] or menagerie:NAME. `name@identity` is that "
        "very one.",
        examples=["go1", "go2"],
    )
    policy: Annotated[str, Field(min_length=1)] = Field(
        description="Default policy: a bundle's name, its folder, its card, or "
        "hub:org/name[@revision]. --policy overrides."
    )
    protocol: Protocol = Field(
        "strict",
        description="Rules of a trial. neverwhere-2026 is the published evaluation, bug for bug.",
    )
    trials: int = Field(
        ge=1, le=100_000, description="Trials per scene and cell of `perturb`. --trials overrides."
    )
    seed: int = Field(ge=0, lt=2**63, description="Names the pinned seed set. --seed overrides.")
    episode: EpisodeRules = EpisodeRules()  # pyright: ignore[reportCallIssue]  # Defaults sit in Field.
    task: AnyTask = Field(
        COURSE,
        description="What the robot is to do: the name of a kind of task, or a mapping with `kind` "
        "and its keys. course: the scene's waypoints in their order.",
    )
    scenes: Patterns = Field(
        description="Names, globs, paths of scene folders, neverwhere:<path or name> for a "
        "published one, hub:org/name[@revision] for one of a hub."
    )
    perturb: Perturb = Perturb()  # pyright: ignore[reportCallIssue]
    render: Rendering = Field(
        PUBLISHED,
        description="How the pictures of splats are drawn. Baselines of another kind of picture "
        "are not comparable.",
    )
    scores: tuple[str | OwnScore, ...] = Field(
        (),
        description="What is measured of each trial beside success, by name "
        "(docs/reference/scores.md), or as a mapping with `python`, a function of one's own. Those "
        "that gate.scores names are measured, too.",
    )
    expect: dict[Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,56}$")], Expectation] = Field(
        {},
        description="What is expected of each trial, by a name. Each is a score, `expect_<name>`: "
        "1 where a trial keeps it, 0 where not.",
    )
    record: Record = Field(
        "failures",
        description="Trials whose images are kept in the logs; `summary` keeps neither images nor "
        "control steps. --record overrides.",
    )
    gate: Gate = Gate()  # pyright: ignore[reportCallIssue]
    plugins: dict[str, str] = Field(
        {},
        description="Package and version of each name of the suite that a package provides, "
        "such as `axes.action_delay: my-package 1.0`; filled in where absent. It is an error if "
        "another version is installed.",
    )

    _source: Source = PrivateAttr(default_factory=Source)

    @field_validator("render")
    @classmethod
    def _drawn_by_the_protocol(cls, render: Rendering, info: ValidationInfo) -> Rendering:
        name = info.data.get("protocol")  # None where it is at fault itself.
        if name is not None and protocol_named(name).fixed_pictures and render != PUBLISHED:
            raise ValueError(
                f"{name} draws with ewa, 1 sample and near 0.01; remove it, or set protocol: strict"
            )
        return render

    @field_validator("scores")
    @classmethod
    def _known_scores(
        cls, scores: tuple[str | OwnScore, ...], info: ValidationInfo
    ) -> tuple[str | OwnScore, ...]:
        names = [each if isinstance(each, str) else each.spec.name for each in scores]
        declared([each for each in scores if isinstance(each, str)], info)
        # What the task declares would stand beside it in rows and gates, by the same name.
        of_task: Mapping[str, ScoreSpec] = (info.context or {}).get("task", {})
        for each in scores:
            if isinstance(each, str):
                continue
            name = each.spec.name
            if name in SCORE_CLASSES or name == "success":
                raise ValueError(f"{name!r} is built in; set another `name`")
            if name in of_task:
                raise ValueError(f"{name!r} is a score of the task; set another `name`")
        each_once(tuple(names))
        return scores

    @field_validator("expect")
    @classmethod
    def _known_expectations(
        cls, expect: dict[str, Expectation], info: ValidationInfo
    ) -> dict[str, Expectation]:
        named = [each.score for each in expect.values() if each.score is not None]
        declared(named, info)
        if of_task := [name for name in named if name in (info.context or {}).get("task", ())]:
            raise ValueError(f"{of_task[0]!r} is a score of the task's own; name it in gate.scores")
        return expect

    @model_validator(mode="after")
    def _bounded_grid(self) -> Self:
        cells = prod(map(len, self.perturb.axes.values()))
        if cells > MAX_CELLS:
            raise ValueError(f"perturb has {cells} cells, over {MAX_CELLS}; name fewer values")
        return self

    @property
    def source(self) -> Source:
        """The file that the suite was read from, with the positions of its settings."""
        return self._source

    @property
    def base(self) -> Path:
        """The folder that relative scene and policy paths of the file start from."""
        return self._source.base

    @property
    def motion(self) -> Path | None:
        """The file of the motion that its task names; None where it names none."""
        named = getattr(self.task, "motion", None)
        return None if named is None else (self.base / named.file).absolute()

    @property
    def own_scores(self) -> tuple[OwnScore, ...]:
        """Scores that are Python functions of the suite."""
        return tuple(each for each in self.scores if isinstance(each, OwnScore))

    @property
    def own_code(self) -> dict[str, str]:
        """Which code `own_scores` are, by `key_of` its name: file, function and SHA-256.

        Raises:
            UsageError: a file cannot be read.
        """
        return {
            key_of(SCORES, each.spec.name): f"{each.python} {source_digest(each, self.base)}"
            for each in self.own_scores
        }

    @property
    def measured(self) -> dict[str, ScoreSpec]:
        """Scores of its trials beside the task's own, with what each declares.

        Those it lists, those that its gate judges, and what it expects.
        """
        own = _own_scores(self.model_dump(include={"scores", "expect"}))
        theirs = {each.name for each in declared_by(self.task)}
        names = [each if isinstance(each, str) else each.spec.name for each in self.scores]
        names += [name for name in self.gate.scores if name not in theirs]
        names += [EXPECT + name for name in self.expect]
        return {
            name: own[name] if name in own else specs_of([name])[name]
            for name in dict.fromkeys(names)
        }

    def measured_by(self) -> tuple[str, ...]:
        """Return how jobs name the scores of `measured`: built-in ones, packages' and its own.

        Raises:
            UsageError: the file of a function cannot be read.
        """
        own = {each.spec.name: each for each in self.own_scores}
        texts = {name: own_text(each, self.base) for name, each in own.items()}
        for name, each in self.expect.items():
            texts[EXPECT + name] = expectation_text(name, each, texts.get(each.score or ""))
        return tuple(texts.get(name, name) for name in self.measured)

    @property
    def digest(self) -> str:
        """Hex sha256 of what decides the course of its trials; see `digest_of_trials`."""
        return digest_of_trials(self.model_dump())

    @property
    def content_digest(self) -> str:
        """Hex sha256 of everything that the suite says, gate and all."""
        said = self.model_dump(by_alias=True)
        # A suite that says nothing of its rounds has the digest that it had when they were 20.
        return digest_of({**said, "gate": {"rounds": 20, **said["gate"]}})


def new_suite(settings: Mapping[str, Any], source: Source | None = None) -> Suite:
    """Make a suite from the settings of a file; lists become tuples.

    The versions of packages that `plugins` does not say are those that are installed.

    Raises:
        pydantic.ValidationError: settings cannot be used.
    """
    frozen: dict[str, Any] = _frozen(settings)
    said: Any = frozen.get("plugins")
    if said is None or isinstance(said, dict):
        said = {**_installed_plugins(frozen), **cast("dict[str, Any]", said or {})}
    suite = Suite.model_validate(
        {**frozen, "plugins": said} if said else frozen,
        context={
            "plugins": settings.get("plugins") or {},
            "own": _own_scores(frozen),
            "task": _own_scores({"task": frozen.get("task")}),
        },
    )
    if source is not None:
        # Only its maker knows where it was written; it is no setting.
        suite._source = source  # noqa: SLF001  # pyright: ignore[reportPrivateUsage]
    return suite


def _installed_plugins(settings: Mapping[str, Any]) -> dict[str, str]:
    """Return the versions of the packages that have what settings name; none is imported."""
    task, scores = settings.get("task"), settings.get("scores")
    measured = cast("tuple[Any, ...]", scores) if isinstance(scores, tuple) else ()
    gated = _mapping(_mapping(settings.get("gate")).get("scores"))
    named: list[tuple[str, Any, Container[str]]] = [
        *((GROUP, name, AXES) for name in _mapping(settings.get("perturb"))),
        *((SCORES, name, SCORE_CLASSES) for name in (*measured, *gated)),
        (TASKS, task if isinstance(task, str) else _mapping(task).get("kind"), TASK_CLASSES),
    ]
    found: dict[str, str] = {}
    for group, name, built_in in named:
        if not isinstance(name, str):
            continue
        if name in built_in:
            if group != GROUP:  # Of axes the grid warns, where they have values.
                warn_if_built_in(group, name)
        elif (version := version_of(group, name)) is not None:
            found[key_of(group, name)] = version
    return dict(sorted(found.items()))


def _own_scores(settings: Mapping[str, Any]) -> dict[str, ScoreSpec]:
    """Return the declarations of scores that settings make up, and of their task's own.

    What is wrong with them is said where they are validated.
    """
    found: dict[str, ScoreSpec] = {}
    task = settings.get("task")
    kind = task if isinstance(task, str) else _mapping(task).get("kind", COURSE.kind)
    if isinstance(kind, str):
        with suppress(NwEvalError):
            found |= {each.name: each for each in declared_by_kind(kind)}
    listed = settings.get("scores")
    for each in cast("tuple[Any, ...]", listed) if isinstance(listed, tuple | list) else ():
        with suppress(ValidationError):
            spec = OwnScore.model_validate(each).spec
            found[spec.name] = spec
    for name, each in _mapping(settings.get("expect")).items():
        with suppress(ValidationError, NwEvalError):
            expected = Expectation.model_validate(each)
            known = found if expected.score in found else {}
            unit = ""
            if expected.score is not None:
                unit = (known or specs_of([expected.score]))[expected.score].unit
            spec = expectation_spec(str(name), expected, unit)
            found[spec.name] = spec
    return found


def _mapping(value: Any) -> Mapping[Any, Any]:
    return cast("Mapping[Any, Any]", value) if isinstance(value, Mapping) else {}


def plugin_faults(suite: Suite) -> list[Problem]:
    """Return a problem for each package that a suite needs and that is not installed so."""
    problems: list[Problem] = []
    for key, said in suite.plugins.items():
        found = version_named(key)
        if found != said:
            have = "is not installed" if found is None else f"is {found} here"
            package, _, version = said.partition(" ")
            problems.append(
                suite.source.problem(
                    ("plugins", key),
                    f"plugins.{key}: it is to be {said}, and {have}",
                    f"pip install '{package}=={version}'" if version else "install its package",
                )
            )
    return problems


def _frozen(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _frozen(item) for key, item in cast("Mapping[Any, Any]", value).items()}
    if isinstance(value, list):
        return tuple(_frozen(item) for item in cast("list[Any]", value))
    return value


_CHANGED = ("robot", "policy", "trials", "seed", "record")
"""What a request may say otherwise than the suite, under the suite's names."""


def override(suite: Suite, request: Request) -> Suite:
    """Return a suite with what a request says otherwise; None keeps a setting.

    Robot and seed are part of `Suite.digest`: with another one the trials are others. With another
    policy, number of trials or record they are still the same.

    Raises:
        UsageError: a value cannot be used, for example `trials` of 0.
    """
    wanted = {name: getattr(request, name) for name in _CHANGED}
    return _with(suite, {name: value for name, value in wanted.items() if value is not None})


def with_robot(suite: Suite, reference: str) -> Suite:
    """Return a suite whose robot was found, by the name that tells it from any other."""
    return suite if suite.robot == reference else _with(suite, {"robot": reference})


def override_gate(
    suite: Suite, *, max_drop: float | None = None, tolerate: float | None = None
) -> Suite:
    """Return a suite with other drops in its gate; None keeps a setting.

    Raises:
        UsageError: a drop cannot be used.
    """
    wanted = {"max_drop": max_drop, "tolerate": tolerate}
    changes = {name: value for name, value in wanted.items() if value is not None}
    return _with(suite, {"gate": {**suite.gate.model_dump(), **changes}}) if changes else suite


def _with(suite: Suite, changes: Mapping[str, Any]) -> Suite:
    try:
        return new_suite({**suite.model_dump(by_alias=True), **changes}, suite.source)
    except ValidationError as error:
        faults = "; ".join(_fault_of(changes, dict(item)) for item in error.errors())
        raise UsageError(faults) from None


def _fault_of(changes: Mapping[str, Any], item: Mapping[str, Any]) -> str:
    """Return which option cannot be used, and why; one that does not fit another says so."""
    if isinstance(item["input"], Mapping):
        return str(item["msg"]).removeprefix("Value error, ")
    name = str(item["loc"][-1] if item["loc"] else next(iter(changes)))
    why = explain_limit(item) or item["msg"].lower()
    return f"--{name.replace('_', '-')} {item['input']!r}: {why}"


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a suite file.

    In VS Code and others with yaml-language-server, the first line of a suite then says
    `# yaml-language-server: $schema=suite.schema.json`.
    """
    schema = Suite.model_json_schema(by_alias=True)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": "nw-eval suite",
    }
