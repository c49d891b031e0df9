"""A training's folder is evaluated as it fills, by real trials in one scene."""

import json
import os
import re
import shutil
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import onnx
import pyarrow.parquet as pq
import pytest
from onnx import numpy_helper

from nw_base.errors import IncomparableError, StoreError, UsageError
from nw_eval import api
from nw_eval.api import reports, watching
from nw_eval.api.reports import written
from nw_eval.api.watching import checkpoints_in, training_step
from nw_eval.cli.verbs.baseline import saved_page
from nw_eval.cli.verbs.watch import checkpoint_line
from nw_eval.engine.listener import NullListener
from nw_eval.suite import load_suite
from nw_eval.testing import FakeClock
from nw_gate.results.baseline_file import read_baseline
from nw_policies import load_bundle

SUITE = """\
nw-eval: 1
name: one
robot: go1
policy: go1-parkour
trials: 3
seed: 7
episode: {duration: 8.0}
scenes: [hurdles/one_low_carpet]
scores: [mean_power]
gate: {max_drop: 0.5, least_starts: 1}
"""


LADDER = SUITE.replace(
    "least_starts: 1}", "least_starts: 1, limits: {stairs/up: {max_drop: 0.04, trials: 60}}}"
)


@pytest.fixture
def training(tmp_path, monkeypatch):
    """The folder of a training, with the suite beside it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(watching, "STARTS_OF_FEW", 6)  # Ten times as many where it counts.
    (tmp_path / "one.yaml").write_text(SUITE)
    folder = tmp_path / "training"
    folder.mkdir()
    return folder


def good(path):
    shutil.copy(load_bundle("go1-parkour").checkpoint, path)


def bad(path):
    """Write a network that answers nothing."""
    graph = onnx.load(load_bundle("go1-parkour").checkpoint)
    for weights in graph.graph.initializer:
        array = numpy_helper.to_array(weights)
        if array.dtype == np.float32:
            weights.CopyFrom(numpy_helper.from_array(np.zeros_like(array), weights.name))
    onnx.save(graph, path)


def last_run(found):
    return found.checkpoints[-1].run


def watched(training, **settings):
    settings = {"once": True, "interval": 0.05, "workers": 1, **settings}
    return api.watch(training, suite="one.yaml", **settings)


def test_the_latest_comes_first_and_each_is_gated_against_the_best_before_it(training, monkeypatch):
    good(training / "model_2.onnx")
    bad(training / "model_10.onnx")
    (training / "model_7.onnx").write_bytes(b"no graph")
    (training / "events.out.tfevents.1").write_bytes(b"")
    heard = []
    found = watched(training, progress=lambda made: heard.append(made.step))
    assert heard == [10, 7, 2]
    two, seven, ten = found.checkpoints
    assert (two.success, two.verdict) == (1.0, "RAN")
    assert two.against is None, "nobody can be worse than one that never reached a waypoint"
    assert (ten.success, ten.verdict, ten.against) == (0.0, "RAN", None)
    assert "model_7" in seven.problem
    assert seven.verdict == ""
    assert found.best == two
    # That of the newest: nothing was there yet that it could have been worse than.
    assert found.exit_code == 0
    maps = ("scores", "limits")
    rows = [
        {**asdict(each), **{name: list(getattr(each, name).items()) for name in maps}}
        for each in (two, seven, ten)
    ]
    assert two.scores["mean_power"] > 50.0
    assert ten.scores.keys() == {"mean_power"}
    assert seven.scores == {}
    assert pq.read_table(found.table).to_pylist() == rows
    page = found.page.read_text(encoding="utf-8")
    assert f'href="{two.run}/report.html"' in page
    assert f'data-of="mean_power">{two.scores["mean_power"]:.4g}<' in page
    assert (found.folder / two.run / "report.html").is_file()
    # What is there is not run again, and what comes is judged against the best.
    bad(training / "model_20.onnx")
    pages = []
    monkeypatch.setattr(
        reports, "written", lambda *run, **how: pages.append(run) or written(*run, **how)
    )
    more = watched(training, progress=lambda made: heard.append(made.step))
    assert len(pages) == 1, "a report is written once"
    assert heard == [10, 7, 2, 20]
    assert (more.checkpoints[-1].verdict, more.checkpoints[-1].against) == ("REGRESSED", 2)
    assert more.exit_code == 1
    assert more.checkpoints[:3] == found.checkpoints
    # The best was chosen by its run: its baseline is of other starts, and so is the comparison.
    [file] = (found.folder / "baselines").rglob("*.parquet")
    baseline, suite = read_baseline(file), load_suite("one.yaml")
    assert baseline.manifest.held_out
    assert (baseline.manifest.starts, baseline.manifest.policy.checkpoint_digest) == (6, two.sha256)
    assert baseline.manifest.key.seed not in {suite.seed, 0}
    verdict = api.judge(found.folder / last_run(more), baseline=str(file)).verdict
    assert (verdict.against.basis, verdict.against.word) == ("fresh", "REGRESSED")
    # The best's own run is compared with it, too: it met other starts.
    own = api.judge(found.folder / two.run, baseline=str(file)).verdict
    assert (own.against.is_own, own.against.word) == (True, "INCONCLUSIVE")
    assert not api.check_baseline(file, suite="one.yaml", policy="go1-parkour",
                                  checkpoint=training / "model_2.onnx").changes  # fmt: skip
    # The drop is of the trials that settled it, which the page and the line say.
    last = more.checkpoints[-1]
    assert 0 < last.drop_trials <= last.trials
    page = more.page.read_text(encoding="utf-8")
    assert (f" in {last.drop_trials}</td>" in page) == (last.drop_trials < last.trials)
    assert "The best is chosen by its success here, which overstates it" in page
    # A baseline of the run itself says that it may have been chosen by it.
    saved = api.save_baseline("one.yaml", run=found.folder / two.run, root=Path("saved"))
    assert saved.may_have_chosen
    assert "note: this run is of a watched training" in saved_page(saved)
    assert checkpoint_line(replace(last, drop_trials=4, trials=9)).endswith(
        "against step 2 in the 4 trials that settled it · completed 0 of 9 trials"
    )


def test_the_exit_code_is_not_that_of_an_earlier_checkpoint_than_the_newest(training):
    good(training / "model_1.onnx")
    (training / "model_2.onnx").write_bytes(b"no graph")
    found = watched(training, trials=1)
    assert [made.verdict for made in found.checkpoints] == ["RAN", ""]
    assert found.exit_code == 2


def test_names_that_are_no_utf_8_and_numbers_that_are_no_steps_stop_nothing(training):
    Path(os.fsdecode(os.fsencode(training) + b"/bad\xff_3.onnx")).write_bytes(b"no graph")
    (training / f"model_{10**25}.onnx").write_bytes(b"no graph")
    found = watched(training, trials=1)
    assert [made.name for made in found.checkpoints] == [r"bad\udcff_3.onnx"]
    assert watched(training, trials=1).checkpoints == found.checkpoints


def test_a_link_out_of_the_folder_is_not_followed(training):
    bad(training.parent / "elsewhere.onnx")
    (training / "model_9.onnx").symlink_to(training.parent / "elsewhere.onnx")
    found = watched(training, trials=1)
    assert found.checkpoints == ()
    assert list((found.folder / "checkpoints").iterdir()) == []


def test_a_checkpoint_that_appears_is_taken_once_it_is_whole(training, monkeypatch):
    good(training / "model_1.onnx")
    whole = (training / "model_1.onnx").read_bytes()
    size = len(whole) // 4 + 1
    parts = [whole[first : first + size] for first in range(0, len(whole), size)]
    now, heard = FakeClock(), []

    def sleep(seconds):
        """Let the training write a quarter of its next checkpoint between two looks."""
        now.advance(seconds)
        if heard and parts:
            with (training / "model_2.onnx").open("ab") as stream:
                stream.write(parts.pop(0))

    monkeypatch.setattr(watching, "time", SimpleNamespace(monotonic=now, sleep=sleep))
    found = watched(training, once=False, idle=0.3, progress=heard.append)
    assert [(made.step, made.problem) for made in heard] == [(1, ""), (2, "")]
    assert [(made.success, made.against) for made in heard] == [(1.0, None), (1.0, 1)]
    assert found.best.step == 1


def test_a_file_that_changes_under_its_name_is_another_checkpoint(training):
    bad(training / "model_5.onnx")
    assert watched(training).best.success == 0.0
    good(training / "model_5.onnx")
    found = watched(training)
    assert [made.success for made in found.checkpoints] == [0.0, 1.0]
    assert len({made.sha256 for made in found.checkpoints}) == 2


def test_each_second_step_is_evaluated(training):
    for step in (100, 200, 300):
        bad(training / f"model_{step}.onnx")
    assert [made.step for made in watched(training, every=2, trials=1).checkpoints] == [100, 300]


def test_steps_are_the_last_number_of_a_name_or_of_its_folder(tmp_path):
    for name in (
        "model_1500.pt", "run3/000020/params.msgpack", "run_2/agent_9_final.pt", "best.pt",
        "model_99.txt", "model_100.pt",
    ):  # fmt: skip
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    names = [str(path.relative_to(tmp_path)) for path in checkpoints_in(tmp_path)]
    steps = [training_step(tmp_path / name) for name in names if name != "best.pt"]
    assert steps == [9, 20, 100, 1500]
    assert checkpoints_in(tmp_path, "model_1*") == [
        tmp_path / "model_100.pt", tmp_path / "model_1500.pt"
    ]  # fmt: skip


def test_a_folder_of_another_suite_or_with_damaged_state_is_refused(training):
    bad(training / "model_1.onnx")
    found = watched(training, trials=1)
    with pytest.raises(IncomparableError, match="another suite, card, scenes or number of trials"):
        watched(training, trials=2)
    state = found.folder / "watch.json"
    kept = json.loads(state.read_text(encoding="utf-8"))
    kept["checkpoints"][0]["success"] = "all of it"
    state.write_text(json.dumps(kept), encoding="utf-8")
    with pytest.raises(StoreError, match=r"watch\.json is damaged"):
        watched(training, trials=1)


@pytest.mark.parametrize(
    ("settings", "words"),
    [({"every": 0}, "every 0"), ({"interval": 0.0}, "interval 0"), ({"idle": -1.0}, "idle -1")],
)
def test_numbers_of_no_use_are_refused_before_anything_runs(training, settings, words):
    with pytest.raises(UsageError, match=words):
        watched(training, **settings)
    assert not (training.parent / "reports").exists()


class Ears(NullListener):
    def __init__(self):
        self.heard = []

    def message(self, text):
        self.heard.append(text)


def test_that_no_checkpoint_can_pass_with_so_few_trials_is_said_before_any_runs(training):
    few, enough = Ears(), Ears()
    page = watched(training, listener=few).page.read_text(encoding="utf-8")
    words = "3 trials cannot exclude a drop of 0.5 from the best checkpoint even if all of both are"
    assert [words in text for text in few.heard] == [True]
    assert f"cannot PASS: {words}" in page
    least = int(re.search(r"--trials (\d+)", few.heard[0])[1])
    watched(training, listener=enough, trials=least, out=training.parent / "enough")
    assert enough.heard == []


def test_what_is_no_folder_is_refused(training):
    with pytest.raises(UsageError, match="not a folder"):
        watched(training / "nothing")


@pytest.mark.slow
@pytest.mark.nightly
def test_limits_of_each_checkpoint_are_searched_and_drawn_over_the_steps(training):
    Path("one.yaml").write_text(LADDER)
    good(training / "model_20.onnx")
    bad(training / "model_10.onnx")
    found = watched(training, record="none", workers=2)
    low, high = found.checkpoints[1].limits["stairs/up"]
    # On fixed rungs, 24 trials each, this policy completes 23 at 0.20 m and 0 at 0.24 m.
    assert (low, high) in {(0.20, 0.24), (0.20, 0.22), (0.22, 0.24)}
    low, high = found.checkpoints[0].limits["stairs/up"]
    assert (low, high) == (None, 0.10)
    page = found.page.read_text()
    assert "Limits by training step" in page
    assert "0.2, not 0.2" in page
    table = pq.read_table(found.table).to_pylist()
    assert dict(table[0]["limits"])["stairs/up"] == [None, 0.10]
    worse = api.report(found.folder / found.checkpoints[0].run)
    (limit,) = worse.verdict.limits
    assert limit.candidate.upper.value == 0.10
