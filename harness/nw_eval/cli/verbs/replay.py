"""`nw-eval replay`: a recorded trial again, bit for bit or under another policy; or its log."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated

import tyro

from nw_base.clean import clean
from nw_base.plural import plural
from nw_base.words import Viewer
from nw_eval.cli.verbs.shared import AllowCode, Checkpoint

if TYPE_CHECKING:
    from pathlib import Path

    from nw_eval.viewing.recording.track import WrittenRecording
    from nw_sim.rollout.replaying.reports import Difference, Ending, ReplayReport, TakeoverReport


@dataclass(frozen=True, kw_only=True)
class Replay:
    """Re-run a recorded trial from its log and check that the results are identical.

    With --from, another policy takes control at that second, from the recorded state. With --layout
    or --rrd, the log is shown and nothing is re-run.
    """

    log: tyro.conf.Positional[Path]
    """A trial's MCAP file."""
    policy: Annotated[str | None, tyro.conf.arg(aliases=["-p"])] = None
    """The recorded policy, if it moved; with --from, the policy that takes control."""
    checkpoint: Checkpoint = None
    start: float = 0.0
    """Start from the last recorded state at or before this second."""
    takeover: Annotated[float | None, tyro.conf.arg(name="from", metavar="FLOAT")] = None
    """The second at which --policy, or the recorded card with --checkpoint, takes control."""
    picture: Path | None = None
    """Write the trial's contact sheet (third person and robot's eye) to this PNG."""
    video: Path | None = None
    """Film the trial in real time, third person beside the policy's view, to this MP4 (needs
    nw-eval[video])."""
    layout: Viewer | None = None
    """Print a layout of the log to import in Foxglove or Lichtblick. For Rerun, write a blueprint
    beside the log (needs nw-eval[rerun]) and print the commands that use it."""
    out: Path | None = None
    """The file that --layout writes: a .json, or an .rbl for Rerun. With --from, the new trial's
    log: an .mcap."""
    rrd: Path | None = None
    """Write the log as a Rerun recording, an .rrd (needs nw-eval[rerun])."""
    allow_code: AllowCode = False

    def __call__(self) -> int:
        if self.takeover is not None:
            return self._take_over(self.takeover)
        if self.layout is not None or self.rrd is not None or self.out is not None:
            return self._show()
        from nw_base.errors import StoreError
        from nw_eval import api

        replayed = api.replay(
            self.log,
            policy=self.policy,
            checkpoint=self.checkpoint,
            start=self.start,
            picture=self.picture,
            video=self.video,
            allow_code=self.allow_code,
        )
        print(replay_line(replayed))
        _print_written(replayed.picture, replayed.video)
        return 0 if replayed.is_identical else StoreError.exit_code

    def _take_over(self, start: float) -> int:
        from nw_eval import api

        self._refuse(
            {
                "--start": self.start or None,
                "--picture": self.picture,
                "--layout": self.layout,
                "--rrd": self.rrd,
            },
            "is not for a policy switch, which --from is",
        )
        taken = api.take_over(
            self.log,
            start=start,
            policy=self.policy,
            checkpoint=self.checkpoint,
            out=self.out,
            video=self.video,
            allow_code=self.allow_code,
        )
        print(takeover_page(taken))
        _print_written(taken.log, taken.video)
        return 0

    def _show(self) -> int:
        import json

        from nw_eval import api

        self._check_shown()
        if self.layout == "foxglove":
            layout = api.foxglove_layout(self.log, self.out)
            print(json.dumps(layout, indent=2) if self.out is None else self.out)
        elif self.layout == "rerun":
            out = self.out or self.log.with_suffix(".rbl")
            print(layout_lines(self.log, api.rerun_layout(self.log, out)))
        if self.rrd is not None:
            print(recording_line(api.rerun_recording(self.log, self.rrd)))
        return 0

    def _check_shown(self) -> None:
        from nw_base.errors import UsageError

        if self.layout is None and self.out is not None:
            raise UsageError("--out is where --layout writes", fix="add --layout foxglove or rerun")
        shows = "--layout" if self.layout is not None else "--rrd"
        self._refuse(
            {
                "--policy": self.policy,
                "--checkpoint": self.checkpoint,
                "--start": self.start or None,
                "--picture": self.picture,
                "--video": self.video,
                "--allow-code": self.allow_code or None,
            },
            f"is for running the trial again, {shows} runs nothing",
        )

    @staticmethod
    def _refuse(options: dict[str, object], why: str) -> None:
        """Refuse the first of these options that is given.

        Raises:
            UsageError: one is.
        """
        from nw_base.errors import UsageError

        for option, value in options.items():
            if value is not None:
                raise UsageError(f"{option} {why}", fix="give them in two commands")


def _print_written(*files: Path | None) -> None:
    for file in files:
        if file is not None:
            print(file)


def replay_line(replay: ReplayReport) -> str:
    """Return how a replay ended, or what of it is not as it was recorded."""
    start = "" if replay.start_step == 0 else f" from step {replay.start_step}"
    return clean(
        f"{replay.trial}{start}: {_replayed_end(replay)}", at_most=2000
    )  # Most words are the log's.


def _replayed_end(replay: ReplayReport) -> str:
    if replay.is_identical:
        return f"{replay.end} after {plural(replay.steps, 'step')}, identical bit for bit"
    differences = "; ".join(
        f"{each.name} was {_short(each, each.recorded)}, now {_short(each, each.now)}"
        for each in replay.differences
    )
    versions = ", ".join(
        f"{each.name} {each.recorded or 'unknown'}, not {each.now or 'none'}"
        for each in replay.versions
    )
    return f"{differences} (recorded with {versions})" if versions else differences


def _short(difference: Difference, value: str) -> str:
    text = value or "none"
    return text[:12] if difference.name.endswith("_digest") else clean(text, at_most=100)


def takeover_page(taken: TakeoverReport) -> str:
    """Return how a trial ended under its own policy, and how it does under the other one."""
    was, after = taken.was, taken.now
    head = (
        f"{taken.trial}: {after.policy} takes over from {was.policy} at "
        f"{_seconds(taken.step, was.control_rate):.2f} s"
    )
    lines = [clean(head), f"  was  {_taken_end(was)}", f"  now  {_taken_end(after)}"]
    if taken.is_identical:
        lines.append("  the same, bit for bit")
    return "\n".join(lines)


def _taken_end(ending: Ending) -> str:
    """Return how, when and where."""
    how = clean(f"{ending.end} ({ending.reason})" if ending.reason else ending.end, at_most=300)
    seconds = _seconds(ending.steps, ending.control_rate)
    when = f"at {seconds:.2f} s, {clean(ending.waypoints)} waypoints"
    if ending.position is None:
        return f"{how} {when}"
    x, y, z = ending.position
    return f"{how} {when}, at x {x:.2f}, y {y:.2f}, z {z:.2f} m"


def _seconds(steps: int, control_rate: float) -> float:
    return steps * (1.0 / control_rate)


def layout_lines(log: Path, layout: Path) -> str:
    """Return where Rerun's layout is, and the commands that show the log by it."""
    converted = layout.with_suffix(".rrd")
    return (
        f"{clean(layout)}\n"
        f"rerun mcap convert --application-id nw-eval {_quoted(log)} -o {_quoted(converted)}\n"
        f"rerun {_quoted(layout)} {_quoted(converted)}"
    )


def recording_line(written: WrittenRecording) -> str:
    """Return what a recording is, and what it lacks."""
    splat = plural(written.gaussians, "Gaussian") if written.gaussians else "no splat"
    lack = f" ({clean(written.no_splat)})" if written.no_splat else ""
    return f"{clean(written.file)}: {written.bytes / 1e6:.1f} MB, {splat}{lack}"


def _quoted(path: Path) -> str:
    return clean(quote(str(path)))
