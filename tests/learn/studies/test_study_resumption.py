"""A study that was ended goes on with what is missing: students are trained once, runs run once."""

from contextlib import nullcontext

import pytest

from nw_base.errors import UsageError
from nw_eval.engine.listener import NullListener
from nw_learn.studies.kinds import SingleScene
from nw_learn.studies.study import StudyProgress, open_study


class Killed(BaseException):
    """The process ends here, with no time to tidy up."""


def opened(config, lines, *, out=None, resume=None):
    def say(line):
        lines.append(line)
        if out is not None and line.startswith("study: 3 of 4"):
            raise Killed

    return open_study(
        SingleScene(),
        config,
        out=out,
        resume=resume,
        say=say,
        listening=lambda: nullcontext(NullListener()),
        workers=1,
    )


def stages(lines):
    return [line.split(" · ")[:2] for line in lines if line.startswith("study: ")]


@pytest.mark.slow
@pytest.mark.timeout(600)  # Of waiting, on a machine that does other things too.
@pytest.mark.nightly
def test_a_study_killed_after_its_first_student_trains_only_the_rest(written, small, tmp_path):
    first, out = [], tmp_path / "study"
    with pytest.raises(Killed):
        opened(written(small), first, out=out).run()
    named = "1 round of 2 trajectories, 300 samples"
    assert stages(first) == [
        ["study: 1 of 4", f"trains 01-hurdles-one_low_carpet: {named}"],
        ["study: 2 of 4", "evaluates 01-hurdles-one_low_carpet after round 1 in 2 scenes"],
        ["study: 3 of 4", f"trains 02-hurdles-two_brick_dusk: {named}"],
    ]
    assert "hurdles/two_brick_dusk" in (out / "table.md").read_text()  # What there is so far.
    kept = {path: path.stat().st_mtime_ns for path in (out / "students").rglob("*.onnx")}
    kept |= {path: path.stat().st_mtime_ns for path in (out / "runs").rglob("*.*")}
    assert kept

    second = []
    study = opened(None, second, resume=out)
    assert study.run()
    assert stages(second) == [
        ["study: 2 of 4 are done already"],
        ["study: 3 of 4", f"trains 02-hurdles-two_brick_dusk: {named}"],
        ["study: 4 of 4", "evaluates 02-hurdles-two_brick_dusk after round 1 in 2 scenes"],
    ]
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    for student in study.students:
        assert (out / "students" / student.name / "curve.png").is_file()
    assert study.folder.table.is_file()
    assert (out / "figure.png").is_file()
    third = []
    assert opened(None, third, resume=out).run()
    assert stages(third) == [["study: 4 of 4 are done already"]]


def test_a_study_is_begun_or_gone_on_with(written, small, tmp_path):
    with pytest.raises(UsageError, match="no config"):
        opened(None, [])
    with pytest.raises(UsageError, match="no study in"):
        opened(None, [], resume=tmp_path)
    with pytest.raises(UsageError, match="exclude each other"):
        opened(written(small), [], out=tmp_path, resume=tmp_path)


def test_what_is_left_is_said_once_a_stage_of_each_kind_has_been_done():
    now, lines = iter([0.0, 0.0, 600.0, 600.0, 660.0, 660.0]), []
    progress = StudyProgress(
        lines.append, ["trains", "evaluates"] * 3, done=[4, 5], clock=lambda: next(now)
    )
    for place, kind in enumerate(["trains", "evaluates", "trains"]):
        progress.begin(place, kind)
        if place < 2:
            progress.end(place)
    assert lines == [
        "study: 1 of 6 · trains",
        "study: 2 of 6 · evaluates · 10 min so far",
        "study: 3 of 6 · trains · 11 min so far · about 11 min left",
    ]
