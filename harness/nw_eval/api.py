"""What one can do with nw-eval. The command line and other doors call these and nothing deeper.

The hall of the house: the only room that sees both wings, the one that makes rows (scenes, sim,
sensors, policies, rollout, engine) and the one that reads them (results, stats, gate, report).
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from fnmatch import fnmatchcase
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from nw_eval.errors import StoreError, UsageError, nearest

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nw_eval.engine.listener import Listener
    from nw_eval.gate.verdict import Verdict
    from nw_eval.policies import Bundle
    from nw_eval.results.row import Row
    from nw_eval.results.run_folder import RunFolder
    from nw_eval.rollout.job import Backend, Record
    from nw_eval.scenes import Scene
    from nw_eval.scenes.terrain.options import Collision
    from nw_eval.splat.turntable import Up
    from nw_eval.suite import Suite, Trial

_PAGE = 120
"""Columns of text where there is no terminal to ask."""

_EYE_HEIGHT = 0.3
"""Metres above the ground at which a quadruped's camera looks at a scene."""


@dataclass(frozen=True, kw_only=True)
class RunReport:
    """A judged run: its verdict, where its evidence lies, and the same in words."""

    folder: Path
    verdict: Verdict
    rows: tuple[Row, ...]
    interrupted: bool
    summary: str

    @property
    def exit_code(self) -> int:
        """0 PASS, 1 REGRESSED, 3 INCONCLUSIVE, 4 errors left or trials missing."""
        return self.verdict.exit_code


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What a run would be."""

    suite: Suite
    bundle: Bundle
    scenes: tuple[Scene, ...]
    references: dict[str, str]
    trials: tuple[Trial, ...]


@dataclass(frozen=True, kw_only=True)
class Message:
    """Words for people, and the exit code that goes with them."""

    text: str
    exit_code: int = 0


def plan(
    suite: str | Path,
    *,
    robot: str | None = None,
    policy: str | None = None,
    checkpoint: Path | None = None,
    trials: int | None = None,
    scenes: Sequence[str] = (),
    record: Record | None = None,
    allow_code: bool = False,
    collision: Collision = "terrain",
) -> Plan:
    """Resolve a suite and a policy to the trials that they mean, and check all of it.

    Args:
        suite: a suite file or the name of a shipped one.
        robot: in place of the suite's own; its trials are others then.
        policy: a bundle's name, folder or card; the suite's own if None.
        checkpoint: weights to use with the card.
        trials: per scene; the suite's own number if None.
        scenes: globs; only scenes that match one of them.
        record: whose camera images the logs keep; the suite's own choice if None.
        allow_code: whether Python code that the card names may be imported.
        collision: how scan meshes collide: as compiled terrain, or by their own triangles.

    Raises:
        UsageError, SuiteError, SceneError, PolicyError: something cannot be used as given.
    """
    from nw_eval import scenes as places
    from nw_eval.policies import load_bundle
    from nw_eval.rollout.vetting import vet_bundle
    from nw_eval.suite import check_scenes, check_tiers, expand, load_suite, override

    told = override(load_suite(suite), robot=robot, policy=policy, trials=trials, record=record)
    check_scenes(told, places.names())
    found = places.match_scenes(told.scenes, told.base, collision=collision)
    check_tiers(told, [scene.name for scene in found])
    chosen = tuple(s for s in found if not scenes or any(fnmatchcase(s.name, p) for p in scenes))
    if not chosen:
        asked = ", ".join(scenes)
        raise UsageError(
            f"--scenes {asked} matches no scene of suite {told.name!r}",
            fix=nearest(asked.replace("*", ""), [scene.name for scene in found]),
        )
    bundle = load_bundle(_policy_reference(told, policy), checkpoint=checkpoint)
    vet_bundle(bundle, told.robot, protocol=told.protocol, allow_code=allow_code)
    return Plan(
        suite=told,
        bundle=bundle,
        scenes=chosen,
        references=places.references(told.scenes, told.base, collision=collision),
        trials=expand(told, chosen),
    )


def check(
    suite: str | Path,
    *,
    robot: str | None = None,
    policy: str | None = None,
    checkpoint: Path | None = None,
    trials: int | None = None,
    scenes: Sequence[str] = (),
    workers: int | None = None,
    allow_code: bool = False,
    collision: Collision = "terrain",
) -> Message:
    """Say what a run would be, without running it: scenes, trials, digests, expected minutes."""
    from nw_eval.engine.forecast import forecast

    made = plan(
        suite,
        robot=robot,
        policy=policy,
        checkpoint=checkpoint,
        trials=trials,
        scenes=scenes,
        allow_code=allow_code,
        collision=collision,
    )
    return Message(text=forecast(made.suite, made.bundle, made.scenes, made.trials, workers))


def run(
    suite: str | Path | None,
    *,
    robot: str | None = None,
    policy: str | None = None,
    checkpoint: Path | None = None,
    trials: int | None = None,
    scenes: Sequence[str] = (),
    workers: int | None = None,
    out: Path | None = None,
    resume: Path | None = None,
    record: Record | None = None,
    time_limit: float | None = None,
    render: Backend = "cpu",
    allow_code: bool = False,
    collision: Collision = "terrain",
    listener: Listener | None = None,
) -> RunReport:
    """Roll a checkpoint out through a suite, write the evidence, and judge it.

    Args:
        suite: a suite file or the name of a shipped one; None only with `resume`.
        robot: in place of the suite's own; its trials are others then.
        policy: a bundle's name, folder or card; the suite's own if None.
        checkpoint: weights to use with the card.
        trials: per scene; the suite's own number if None.
        scenes: globs; only scenes that match one of them.
        workers: processes; one for each core if None.
        out: the run's folder; a new one in `reports/` if None.
        resume: the folder of an interrupted run, whose finished trials are kept.
        record: whose camera images the logs keep; the suite's own choice if None.
        time_limit: wall seconds after which a trial counts as hung.
        render: the splat backend.
        allow_code: whether Python code that the card names may be imported.
        collision: how scan meshes collide: as compiled terrain, or by their own triangles.
        listener: hears of progress.

    Raises:
        UsageError, SuiteError, SceneError, PolicyError: nothing was run.
        IncomparableError: the run to resume was made under something else.
        StoreError: results cannot be written; those that were written stay.
    """
    from nw_eval.engine import session

    if workers is not None and workers < 1:
        raise UsageError(f"--workers {workers}", fix="give at least 1")
    if resume is not None:
        if out is not None:
            raise UsageError("--out and --resume exclude each other", fix="drop --out")
        settings = session.settings_of(resume)
        suite = suite or settings.suite
        robot = robot or settings.robot
        policy = policy or settings.policy
        checkpoint = checkpoint or settings.checkpoint
        trials = trials or settings.trials
        scenes = scenes or settings.scenes
        record = record or settings.record
        collision = settings.collision
    if suite is None:
        raise UsageError("no suite", fix="name one, such as `nw-eval run hurdles`")
    made = plan(
        suite,
        robot=robot,
        policy=policy,
        checkpoint=checkpoint,
        trials=trials,
        scenes=scenes,
        record=record,
        allow_code=allow_code,
        collision=collision,
    )
    folder = session.run(
        made.suite,
        made.bundle,
        made.scenes,
        made.trials,
        references=made.references,
        checkpoint=checkpoint,
        workers=workers,
        out=out,
        resume=resume,
        time_limit=time_limit,
        render=render,
        allow_code=allow_code,
        command=tuple(sys.argv),
        listener=listener,
    )
    return report(folder.path)


def report(run: Path, *, out: Path | None = None) -> RunReport:
    """Judge a run from its rows, write report.md, and return the verdict.

    Raises:
        StoreError: there is no such run, or the report cannot be written.
    """
    from nw_eval.gate.absolute import judge
    from nw_eval.report.markdown import render_markdown, write_report
    from nw_eval.results.provenance import read_run_info
    from nw_eval.results.run_folder import open_run_folder
    from nw_eval.suite import new_suite

    folder = open_run_folder(run)
    info = read_run_info(folder.run_json)
    rows = _rows(folder)
    verdict = judge(rows, new_suite(info.suite).gate, info.planned)
    shown = _as_typed(folder.path)
    write_report(out or folder.report_md, render_markdown(info, rows, verdict, shown))
    return RunReport(
        folder=folder.path,
        verdict=verdict,
        rows=tuple(rows),
        interrupted=info.interrupted,
        summary=_summary(info, rows, verdict, shown),
    )


def replay(
    log: Path,
    *,
    policy: str | None = None,
    checkpoint: Path | None = None,
    start: float = 0.0,
    picture: Path | None = None,
    allow_code: bool = False,
) -> Message:
    """Run a recorded trial again and compare its end bit for bit; exit code 4 if it differs.

    Raises:
        StoreError: the log cannot be read.
        PolicyError, SceneError, UsageError: policy or scene are missing or not as recorded.
    """
    from nw_eval.rollout import replay as rollouts

    replayed = rollouts.replay(
        log, policy=policy, checkpoint=checkpoint, start=start, allow_code=allow_code
    )
    text = replayed.text
    if picture is not None:
        from nw_eval.rollout.contact_sheet import write_contact_sheet

        write_contact_sheet(replayed.recording, picture)
        text += f"\n{picture}"
    return Message(text=text, exit_code=0 if replayed.is_identical else StoreError.exit_code)


def list_scenes(patterns: Sequence[str] = ()) -> str:
    """Return a table of scenes: name, waypoints, title."""
    from nw_eval.scenes import match_scenes

    found = match_scenes(tuple(patterns) or ("*",))
    width = max(len(scene.name) for scene in found)
    return "\n".join(
        f"{scene.name:{width}}  {len(scene.trail)} waypoints  {scene.title}" for scene in found
    )


def show_scene(reference: str, *, out: Path | None = None) -> str:
    """Return a scene's figures as lines of text, and draw it from above if asked.

    Raises:
        SceneError: there is no such scene, or it cannot be read.
        StoreError: the picture cannot be written.
    """
    from nw_eval.scenes import get_scene
    from nw_eval.scenes.plan_view import draw_plan, figures

    scene = get_scene(reference)
    if out is not None:
        draw_plan(scene, out)
    return "\n".join([*figures(scene), *([str(out)] if out is not None else [])])


def check_scenes(references: Sequence[str]) -> Message:
    """Return what is wrong with scenes, one line a finding; exit code 2 if anything is."""
    from nw_eval.errors import SceneError
    from nw_eval.scenes.health.finding import has_errors
    from nw_eval.scenes.health.inspect import inspect_scene

    lines: list[str] = []
    is_bad = False
    for reference in references:
        findings = inspect_scene(reference)
        is_bad |= has_errors(findings)
        lines += [f"{reference}: {finding}" for finding in findings]
        if not findings:
            lines.append(f"{reference}: nothing wrong")
    return Message(text="\n".join(lines), exit_code=SceneError.exit_code if is_bad else 0)


def list_sensors() -> str:
    """Return the sensors and wrappers that cards can name, with the packages of plug-ins."""
    from nw_eval.policies.observations import BUILT_IN_SENSORS
    from nw_eval.policies.observations.plugins import SENSORS, WRAPPERS
    from nw_eval.policies.observations.wraps import BUILT_IN_WRAPPERS
    from nw_eval.sensors.plugins import usable

    lines: list[str] = []
    for group, built_in in ((SENSORS, BUILT_IN_SENSORS), (WRAPPERS, BUILT_IN_WRAPPERS)):
        lines.append(f"{group}: {', '.join(built_in)}")
        lines += [f"  {name} of {package}" for name, package in usable(group, built_in).items()]
    return "\n".join(lines)


def draw_sensors(policy: str | None, *, scene: str, out: Path, allow_code: bool = False) -> str:
    """Draw what a card's sensors see, or one frame of every sensor; return the shapes in words.

    Raises:
        SceneError, PolicyError, UsageError: scene or policy cannot be used.
    """
    from nw_eval.policies import load_bundle
    from nw_eval.scenes import get_scene
    from nw_eval.sensors.gallery import draw_card, draw_gallery

    place = get_scene(scene)
    if policy is None:
        draw_gallery(place, out)
        return ""
    return draw_card(load_bundle(policy), place, out, allow_code=allow_code)


def render_scenes(
    patterns: Sequence[str] = (), *, out: Path, width: int = 480, listener: Listener | None = None
) -> None:
    """Draw scenes from the robot's eye and from outside into one PNG.

    Raises:
        SceneError: no such scene. StoreError: the picture cannot be written.
    """
    from nw_eval.engine.listener import Silence
    from nw_eval.engine.prepare import build_splats
    from nw_eval.rollout.contact_sheet import write_scene_sheet
    from nw_eval.scenes import match_scenes

    found = match_scenes(tuple(patterns) or ("*",))
    build_splats(found, listener or Silence())
    write_scene_sheet(found, out, width=width)


def list_policies() -> str:
    """Return a table of the shipped and the project's bundles, and of the example cards."""
    from nw_eval.policies.listing import policy_table

    return policy_table()


def show_policy(policy: str, *, allow_code: bool = False) -> str:
    """Return what a card says: each observation term, each joint, the checkpoint.

    Raises:
        PolicyError: there is no such card, or it has problems.
    """
    from nw_eval.policies import find_card
    from nw_eval.rollout.probe.summary import card_summary

    return card_summary(find_card(policy), allow_code=allow_code)


def check_policy(
    policy: str,
    *,
    checkpoint: Path | None = None,
    scene: str | None = None,
    allow_code: bool = False,
) -> Message:
    """Run a policy for one second and say what is odd; exit code 2 if something is wrong.

    Args:
        policy: a bundle's name, folder or card.
        checkpoint: weights to use with the card.
        scene: where; a flat room if None.
        allow_code: whether Python code that the card names may be imported.

    Raises:
        PolicyError, SceneError: it cannot be run at all.
    """
    from nw_eval.policies import load_bundle
    from nw_eval.rollout.probe.report import FLAT, probe_policy

    bundle = load_bundle(policy, checkpoint=checkpoint)
    told = probe_policy(bundle, scene=scene or FLAT, allow_code=allow_code)
    return Message(text=told.text, exit_code=0 if told.passed else UsageError.exit_code)


def init_policy(checkpoint: Path, *, robot: str, out: Path | None = None) -> Message:
    """Inspect a checkpoint without running it, and write a first card beside it.

    Args:
        checkpoint: any format that an adapter reads.
        robot: which robot the policy drives.
        out: the card to write; `policy.yaml` beside the checkpoint if None.

    Raises:
        PolicyError: the file cannot be read, could run code, or holds an unknown network.
        UsageError: there is a card already.
    """
    from nw_eval.policies.card import CARD_FILE
    from nw_eval.policies.inspect import inspect_checkpoint, write_card_draft
    from nw_eval.robots import get_robot

    card = out or checkpoint.parent / CARD_FILE
    if card.exists():
        raise UsageError(f"{card} exists already", fix="move it away, or name another with --out")
    text = write_card_draft(inspect_checkpoint(checkpoint), get_robot(robot))
    write_text(card, text)
    return Message(text=f"{text}\n{card}: {text.count('CHECK')} lines to check")


def splat_info(path: Path) -> str:
    """Return what a file of Gaussians holds, in lines of text.

    Raises:
        SceneError: it cannot be read.
    """
    from nw_eval.splat.describe import describe
    from nw_eval.splat.files import read_splat

    return "\n".join(describe(read_splat(path)).lines())


def splat_convert(path: Path, out: Path) -> str:
    """Write the Gaussians of one file as another, and return what was written, in words.

    Raises:
        SceneError: the file cannot be read, or its Gaussians do not fit the new format.
        UsageError: a format that cannot be written.
    """
    from nw_eval.splat.files import read_splat, write_splat

    gaussians = read_splat(path)
    write_splat(out, gaussians)
    return f"{out}: {len(gaussians):,} Gaussians, {out.stat().st_size / 2**20:.1f} MiB"


def splat_render(
    source: str,
    out: Path,
    *,
    size: tuple[int, int] = (640, 360),
    up: Up = "-y",
    eye: tuple[float, float, float] | None = None,
    target: tuple[float, float, float] | None = None,
    frames: int = 48,
    backend: Backend = "cpu",
) -> None:
    """Draw a file of Gaussians or a built-in scene: PNG from a pose, a turn as GIF or MP4.

    Args:
        source: path of a file, or a scene's name.
        out: .png, .gif or .mp4.
        size: pixels across and down.
        up: upward axis of a file's frame; scenes have +z.
        eye: where the camera stands, in the splat's own frame; chosen if None.
        target: what it looks at; the middle of a file, or straight ahead in a scene, if None.
        frames: of a turn: around a file, or on the spot in a scene.
        backend: the renderer.

    Raises:
        SceneError, UsageError, PrerequisiteError: something cannot be read, drawn or written.
    """
    from nw_eval import scenes
    from nw_eval.splat import portrait

    suffix = out.suffix.lower()
    if suffix not in portrait.SUFFIXES:
        known = ", ".join(portrait.SUFFIXES)
        raise UsageError(f"{out}: cannot draw {suffix or 'nothing'!r}", fix=f"name one of {known}")
    if target is not None and eye is None:
        raise UsageError("--target without --eye", fix="say where the camera stands too")
    if source in scenes.names():
        scene = scenes.get_scene(source)
        x, y, z = scene.spawn.position
        subject = portrait.of_store(scene.splat_store(), stand=(x, y, z + _EYE_HEIGHT))
    else:
        subject = portrait.of_file(Path(source), up=up)
    subject.draw(out, size=size, eye=eye, target=target, frames=frames, backend=backend)


def warmup(scenes: Sequence[str] = (), *, listener: Listener | None = None) -> str:
    """Compile the kernels into the cache and build scenes ahead; return what was done, in words."""
    from nw_eval.engine.listener import Silence
    from nw_eval.engine.prepare import build_splats
    from nw_eval.scenes import match_scenes
    from nw_eval.splat.warmup import warmup as compile_kernels

    seconds = compile_kernels()
    found = match_scenes(tuple(scenes)) if scenes else ()
    build_splats(found, listener or Silence())
    built = f", {len(found)} scenes built" if found else ""
    return f"kernels ready after {seconds:.1f} s{built}"


def schema(kind: Literal["suite", "policy"]) -> str:
    """Return the JSON Schema of suite files or policy cards."""
    if kind == "suite":
        from nw_eval.suite import json_schema

        return json.dumps(json_schema(), indent=2)
    from nw_eval.policies import Card

    return json.dumps(Card.model_json_schema(by_alias=True), indent=2)


def write_text(path: Path, text: str) -> None:
    """Write a file, whole or not at all.

    Raises:
        StoreError: it cannot be written.
    """
    from nw_eval.report.markdown import write_report

    write_report(path, text)


def _policy_reference(suite: Suite, given: str | None) -> str:
    """Return what names the policy: a suite's own relative path starts from the suite's folder."""
    own = suite.base / suite.policy
    if given is None and ("/" in suite.policy or own.suffix == ".yaml") and own.exists():
        return str(own)
    return suite.policy


def _rows(folder: RunFolder) -> list[Row]:
    """Return a run's rows: from its Parquet file, or from the journal while there is none."""
    if folder.trials.is_file():
        from nw_eval.results.parquet import read_rows

        return read_rows(folder.trials)[0]
    from nw_eval.results.journal import read_journal

    return list(read_journal(folder.journal).rows)


def _as_typed(path: Path) -> Path:
    """Return a path as one would type it here: relative where it lies below."""
    resolved = path.resolve()
    here = Path.cwd()
    return resolved.relative_to(here) if resolved.is_relative_to(here) else resolved


def _summary(info: Any, rows: Sequence[Row], verdict: Verdict, folder: Path) -> str:
    from rich.console import Console

    from nw_eval.report.console import print_summary

    stream = StringIO()
    screen = Console(file=sys.stdout)
    console = Console(
        file=stream,
        width=screen.width if screen.is_terminal else _PAGE,
        force_terminal=screen.is_terminal,
        no_color=screen.no_color,
    )
    print_summary(console, info, rows, verdict, folder)
    console.print(f"report: {folder / 'report.md'}", highlight=False, soft_wrap=True)
    return "\n".join(line.rstrip() for line in stream.getvalue().splitlines())
