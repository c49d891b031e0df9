"""From a run's folder and a baseline's file to the verdict, as in `nw-eval gate` and `report`."""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from nw_base.errors import IncomparableError, StoreError, UsageError
from nw_eval import api
from nw_eval.cli import main
from nw_gate.results.baseline_file import write_baseline
from nw_gate.results.ended import write_trials
from nw_gate.results.journal import Journal, JournalHeader
from nw_gate.results.provenance import BaselineInfo, StopInfo, read_run_info, write_run_info
from nw_gate.results.run_folder import RunFolder

if TYPE_CHECKING:
    from collections.abc import Iterable

    from nw_gate.results.baseline import BaselineResults
    from nw_gate.results.provenance import RunInfo
    from nw_gate.results.row import Row


BASELINE = Path("reports/baselines/hurdles/shipped.parquet")
GATE = {"gate": {"max_drop": 0.1}}


def write_run(run: RunInfo, rows: Iterable[Row]) -> str:
    """Write a run that has ended with these rows; their seeds become those of its trials."""
    from nw_eval.api.saved_run import saved_suite, saved_trials

    folder = RunFolder(path=Path("run"))
    folder.path.mkdir()
    seeds = {trial.id: trial.seed for trial in saved_trials(run, saved_suite(run))}
    kept = [replace(row, seed=seeds[row.trial_id]) for row in rows]
    header = JournalHeader(
        suite_digest=run.suite_digest,
        policy_digest=run.policy.card_digest,
        scene_digests={name: scene.digest for name, scene in run.scenes.items()},
        engine=run.engine,
    )
    with Journal.create(folder.journal, header) as journal:
        for row in kept:
            journal.append(row)
    write_run_info(folder.run_json, write_trials(folder, run, kept))
    return "run"


def keep(baseline: BaselineResults, path: Path = BASELINE) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_baseline(path, baseline)


@pytest.fixture(autouse=True)
def _somewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def run(make_run):
    return make_run(["a", "b", "c", "d"], 20, drawn_from=60, suite=GATE)


@pytest.fixture
def baseline(run, make_baseline):
    return make_baseline(
        run, {"a": [1.0] * 60, "b": [1.0] * 60, "c": [0.5, 1.0] * 30, "d": [1.0] * 60}
    )


def like(low: float = 1.0) -> dict[str, list[float] | float]:
    return {"a": low, "b": 1.0, "c": [0.5, 1.0] * 30, "d": 1.0}


def gate(*words: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["gate", *words])
    assert isinstance(ended.value.code, int)
    return ended.value.code


def test_rows_that_exist_are_judged_against_a_baseline_and_a_page_is_written_where_asked_for(
    run, baseline, drawn_rows, capsys
):
    keep(baseline)
    folder = write_run(run, drawn_rows(run, like()))
    assert gate(folder, "--baseline", str(BASELINE), "--out", "page.md") == 0
    out = capsys.readouterr().out
    assert "PASS \u00b7 completed " in out
    assert ", drop 0." in " ".join(out.partition("PASS \u00b7 ")[2].split())
    assert out.endswith("report: page.md and page.html\n")
    assert Path("page.md").read_text(encoding="utf-8").startswith("# PASS \u00b7 completed")
    assert not Path("run/report.md").exists()


def test_a_drop_regresses_and_names_the_scene(run, baseline, drawn_rows, capsys):
    keep(baseline)
    folder = write_run(run, drawn_rows(run, like(low=0.25)))
    assert gate(folder, "--baseline", "shipped") == 1
    out = capsys.readouterr().out
    assert "report:" not in out
    reasons = " ".join(out.partition("REGRESSED")[2].split())
    assert "* scene a regressed: 1.00 -> 0.25, worse from waypoint 2" in reasons
    assert "80 trials ran and no bar was judged" in reasons
    # The suite's own margins give way to those that are asked for.
    judged = api.judge(folder, baseline="shipped", max_drop=0.6, tolerate=0.3)
    assert judged.verdict.verdict == "PASS"
    assert judged.verdict.against is not None
    assert (judged.verdict.against.max_drop, judged.verdict.against.tolerate) == (0.6, 0.3)
    with pytest.raises(UsageError, match=r"tolerate 0.3 is over max_drop 0.1"):
        api.judge(folder, baseline="shipped", tolerate=0.3)
    with pytest.raises(UsageError, match=r"--max-drop 2.0: "):
        api.judge(folder, baseline="shipped", max_drop=2.0)


def test_without_a_baseline_only_the_bar_is_judged_and_the_fix_is_named(run, drawn_rows):
    folder = write_run(run, drawn_rows(run, like()))
    for judged in (api.judge(folder), api.judge(folder, baseline="none"), api.report(folder)):
        assert (judged.verdict.verdict, judged.verdict.against) == ("RAN", None)
        assert judged.verdict.reasons[-1] == (
            "max_drop 0.1 was ignored: candidate has no baseline in this suite; `nw-eval baseline "
            "save hurdles --policy candidate` saves one, --baseline names it"
        )


def test_a_suites_baseline_counts_for_its_own_policy_and_for_others_the_bar_alone(
    make_run, make_baseline, drawn_rows
):
    run = make_run(
        ["a"], 20, drawn_from=60, suite={"gate": {"baseline": "shipped", "success_rate": 0.5}}
    )
    run = run.model_copy(update={"own_policy": False})
    keep(make_baseline(run, {"a": [1.0] * 60}))
    folder = write_run(run, drawn_rows(run, {"a": 1.0}))
    for judged in (api.judge(folder), api.report(folder)):
        assert (judged.verdict.verdict, judged.verdict.against) == ("PASS", None)
        assert judged.verdict.reasons[-1] == (
            "max_drop 0.1 was ignored: candidate has no baseline in this suite (shipped is for the "
            "suite's own policy); `nw-eval baseline save hurdles --policy candidate` saves one, "
            "--baseline names it"
        )
    named = api.judge(folder, baseline="shipped").verdict
    assert named.against is not None
    assert named.against.baseline_name == "shipped"


def test_the_baseline_that_a_suite_names_is_the_default(make_run, make_baseline, drawn_rows):
    run = make_run(["a"], 20, drawn_from=60, suite={"gate": {"baseline": "shipped"}})
    keep(make_baseline(run, {"a": [1.0] * 60}))
    folder = write_run(run, drawn_rows(run, {"a": 1.0}))
    assert api.judge(folder).verdict.against is not None
    assert api.judge(folder, baseline="none").verdict.against is None
    # A report is of the run as it was begun: against nothing.
    assert api.report(folder).verdict.against is None


def test_a_report_shows_the_verdict_against_the_baseline_that_the_run_was_started_with(
    run, baseline, drawn_rows, make_baseline
):
    keep(baseline)
    content = BASELINE.read_bytes()
    info = BaselineInfo(
        name="shipped", path=str(BASELINE.resolve()), sha256=sha256(content).hexdigest()
    )
    begun = run.model_copy(update={"baseline": info})
    folder = write_run(begun, drawn_rows(run, like(low=0.25)))
    copy = RunFolder(path=Path(folder)).baseline_file("shipped")
    copy.parent.mkdir()
    copy.write_bytes(content)
    # Whatever becomes of the file, the run's own copy is what it was judged by.
    keep(make_baseline(run, {name: [0.25] * 60 for name in "abcd"}))
    judged = api.report(folder)
    assert judged.verdict.verdict == "REGRESSED"
    assert api.judge(folder).verdict == judged.verdict
    assert "## Success by scene" in Path("run/report.md").read_text(encoding="utf-8")
    assert api.judge(folder, baseline="shipped").verdict.verdict == "PASS"
    copy.unlink()
    gone = api.report(folder).verdict
    assert (gone.verdict, gone.exit_code) == ("INVALID", 5)
    assert "neither its copy of it nor" in gone.reasons[0]
    with pytest.raises(IncomparableError, match="neither its copy of it nor"):
        api.judge(folder)


def test_a_baseline_that_its_own_policy_contradicted_makes_a_run_invalid(run, baseline, drawn_rows):
    keep(baseline)
    digest = sha256(BASELINE.read_bytes()).hexdigest()
    moved = ("the baseline is not what its own policy does: the same actions, other results",)
    info = BaselineInfo(name="shipped", path=str(BASELINE.resolve()), sha256=digest, moved=moved)
    begun = run.model_copy(update={"baseline": info, "stop": StopInfo(first=0)})
    judged = api.report(write_run(begun, drawn_rows(run, {})))
    assert (judged.verdict.verdict, judged.exit_code) == ("INVALID", 5)
    assert judged.verdict.reasons[:-1] == moved


def test_a_short_run_shows_the_scenes_that_it_has_not_met(
    make_run, make_baseline, drawn_rows, capsys
):
    names = [f"s{number}" for number in range(9)]
    run = make_run(names, 20, drawn_from=60, suite={"gate": {"success_rate": 0.5}})
    keep(make_baseline(run, dict.fromkeys(names, [1.0] * 60)))
    info = BaselineInfo(
        name="shipped",
        path=str(BASELINE.resolve()),
        sha256=sha256(BASELINE.read_bytes()).hexdigest(),
    )
    rows = drawn_rows(run, dict.fromkeys(names, 0.0), first=2)
    stop = StopInfo(first=2, trials=dict(Counter(row.scene for row in rows)))
    folder = write_run(run.model_copy(update={"baseline": info, "stop": stop}), rows)
    assert gate(folder) == 1
    judged = api.report(folder).verdict
    assert (judged.verdict, judged.n, judged.errors) == ("REGRESSED", 2, 0)
    assert judged.reasons[0].startswith("mean success is at least ")
    assert not any("missing" in text for text in judged.reasons)
    assert judged.against is not None
    unmet = [item.scene for item in judged.against.scenes if item.candidate is None]
    assert len(unmet) >= 7
    page = Path("run/report.md").read_text(encoding="utf-8")
    table = page.partition("## Success by scene")[2].partition("##")[0]
    lines = [[cell.strip() for cell in line.split("|")] for line in table.splitlines()]
    (line,) = [cells for cells in lines if cells[1:2] == unmet[:1]]
    assert line[2:4] == ["0", "none"]
    assert "1.000" in line[4:]
    assert f">{unmet[0]}<" in Path("run/report.html").read_text(encoding="utf-8")
    assert "nan" not in capsys.readouterr().out.lower()


def test_a_run_that_an_older_nw_eval_drew_round_by_round_is_refused_in_a_sentence(
    run, baseline, drawn_rows, capsys
):
    keep(baseline)
    folder = write_run(run, drawn_rows(run, like()))
    written = read_run_info(Path("run/run.json"))
    assert written.run == 2
    write_run_info(Path("run/run.json"), written.model_copy(update={"run": 1}))
    for words in ((folder, "--baseline", "shipped"), (folder,)):
        assert gate(*words) == 5
        out, err = capsys.readouterr()
        assert out == ""
        assert f"run {run.id} was drawn round by round by an older nw-eval" in err
        assert "run it again" in err
        assert "Traceback" not in err


@pytest.mark.parametrize("rounds", [3, 20])
def test_a_run_on_fresh_starts_that_an_older_nw_eval_ended_early_is_refused_in_a_sentence(
    rounds, baseline, make_run, run_rows, capsys
):
    keep(baseline)
    scores = like()
    known = BaselineInfo(
        name="shipped",
        path=str(BASELINE.resolve()),
        sha256=sha256(BASELINE.read_bytes()).hexdigest(),
    )
    fresh = make_run(list(scores), 20, panel="fresh", baseline=known, suite={**GATE, "seed": 1})
    met = run_rows(fresh, dict.fromkeys(scores, [1.0] * rounds))
    folder = write_run(fresh.model_copy(update={"panel": "pinned"}), met)
    # Version 1 said after how many rounds it was settled, in a field that is read no more.
    write_run_info(
        Path("run/run.json"),
        read_run_info(Path("run/run.json")).model_copy(update={"run": 1, "panel": "fresh"}),
    )
    (Path("run/bank")).mkdir()
    keep(baseline, Path("run/bank/shipped.parquet"))
    for words in ((folder, "--baseline", "shipped"), (folder,)):
        assert gate(*words) == 5
        out, err = capsys.readouterr()
        assert out == ""
        assert f"run {fresh.id} was drawn round by round by an older nw-eval" in err
        assert "run it again" in err


def test_what_does_not_match_ends_with_five_and_never_with_a_verdict(
    run, baseline, drawn_rows, capsys
):
    key = baseline.manifest.key
    newer = key.model_copy(update={"simulator": {**key.simulator, "mujoco": "9.9"}})
    keep(replace(baseline, manifest=baseline.manifest.model_copy(update={"key": newer})))
    folder = write_run(run, drawn_rows(run, like()))
    assert gate(folder, "--baseline", "shipped") == 5
    out, err = capsys.readouterr()
    assert out == ""
    assert "its mujoco is 4.0.0, the baseline's 9.9" in err
    assert "nw-eval baseline save hurdles --policy go1-act-rgb --renew" in err
    assert gate(folder, "--baseline", "other") == 2
    assert gate("nowhere", "--baseline", "shipped") == 2


def test_damaged_rows_and_rows_that_are_none_are_named(run, baseline, drawn_rows):
    keep(baseline)
    folder = write_run(run, drawn_rows(run, like()))
    journal = Path("run/journal.jsonl")
    Path("run/trials.parquet").unlink()
    journal.write_text(
        journal.read_text(encoding="utf-8").replace('"success":1.0', '"success":NaN'),
        encoding="utf-8",
    )
    with pytest.raises(StoreError):
        api.judge(folder, baseline="shipped")


def test_judging_needs_no_simulator(run, baseline, drawn_rows):
    keep(baseline)
    folder = write_run(run, drawn_rows(run, like()))
    code = (
        "import sys\n"
        "from nw_eval.cli import main\n"
        "try:\n"
        f"    main(['gate', {folder!r}, '--baseline', 'shipped', '--out', 'page.md'])\n"
        "finally:\n"
        "    heavy = {'mujoco', 'torch', 'numba', 'onnxruntime', 'matplotlib'}\n"
        "    print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.splitlines()[-1]) == (0, "[]"), done.stderr
