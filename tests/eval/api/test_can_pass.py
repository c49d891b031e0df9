"""Whether a gate can pass is said before anything runs; suites that nw-eval writes can."""

import re
from pathlib import Path

import pytest
from command_line import ends

from nw_base.files.shipped import available
from nw_eval import api
from nw_eval.suite import Gate
from nw_eval.suite.load import write_ready_suite
from nw_gate.absolute import judge, trials_to_pass
from nw_gate.results.row import Row

ROOT = Path(__file__).parents[3]
SUITE = """\
nw-eval: 1
name: few
robot: go1
policy: go1-parkour
trials: {trials}
seed: 7
scenes: [{scenes}]
gate: {{{gate}}}
"""
HERE = "flat/carpet_room"
IN_DOCS = {
    f"{page.name} {name}": text
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
    for name, text in re.findall(
        r"^```yaml (\S+)\n(nw-eval: 1.*?)^```$", page.read_text("utf-8"), re.MULTILINE | re.DOTALL
    )
}


@pytest.fixture
def write(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def suite(gate, *, trials=10, scenes=HERE):
        path = tmp_path / "few.yaml"
        path.write_text(SUITE.format(trials=trials, scenes=scenes, gate=gate))
        return path

    return suite


def perfect(scene, index):
    return Row(
        trial_id=f"{scene}-{index}", suite="s", scene=scene, task="hurdles", robot="go1",
        seed_index=index, seed=index, policy="p", status="ok", outcome="completed", end_reason="",
        completed=True, success=1.0, waypoints_reached=4, waypoints_total=4, steps=1, sim_s=1.0,
        physics_s=0.0, render_s=0.0, policy_s=0.0, log_s=0.0, wall_s=0.0,
        checkpoint_digest="c" * 64, scene_digest="d" * 64,
    )  # fmt: skip


@pytest.mark.parametrize("bar", [0.1, 0.5, 0.75, 0.9, 0.97])
@pytest.mark.parametrize("confidence", [0.8, 0.95, 0.999])
@pytest.mark.parametrize("scenes", [1, 3, 16])
def test_so_many_perfect_trials_pass_and_one_fewer_in_each_scene_does_not(bar, confidence, scenes):
    gate = Gate(success_rate=bar, confidence=confidence)
    needed = trials_to_pass(gate, scenes)
    for trials, passes in ((needed, True), (needed - 1, False)):
        planned = {f"s{k}": trials for k in range(scenes)}
        rows = [perfect(scene, index) for scene in planned for index in range(trials)]
        assert (judge(rows, gate, planned).verdict == "PASS") == passes


def test_check_and_run_say_that_a_gate_cannot_pass_and_plan_says_what_it_takes(write, capsys):
    suite = write("success_rate: 0.75")
    assert ends("check", suite) == 0
    told = (
        "10 trials of 1 scene cannot reach the bar 0.75 even if all are perfect: --trials 15 "
        "(`trials: 15`) is the least that can"
    )
    assert f"no PASS   {told}" in capsys.readouterr().out
    assert ends("check", suite, "--trials", "15") == 0
    assert "no PASS" not in capsys.readouterr().out
    assert ends("plan", suite) == 0
    page = capsys.readouterr().out
    assert "needed    15 trials in each scene, if none of them fails (--trials 15)" in page
    assert f"no PASS   {told}" in page
    curve = [line.split() for line in page.splitlines() if re.match(r" +0\.", line)]
    shares = [[int(cell) for cell in line[1::2]] for line in curve]
    assert all(row[0] == 0 for row in shares)  # Ten trials never pass.
    assert [row[-1] for row in shares] == sorted(row[-1] for row in shares)
    options = ["--trials", "1", "--in-process", "--policy", "stand", "--record", "none"]
    ends("run", suite, *options)
    out = capsys.readouterr()
    assert "this run cannot PASS: 1 trial of 1 scene cannot reach the bar" in out.out + out.err


def test_perturbed_scenes_need_fewer_trials_and_a_part_is_asked_about_as_the_whole(write):
    suite = write("success_rate: 0.75", trials=8)
    suite.write_text(suite.read_text() + "perturb: {friction: [0.6, 1.25]}\n")
    assert api.check(suite).obstacles == ()
    assert "--trials 8 " in api.check(suite, trials=7).obstacles[0]
    assert api.check(suite, shard="1/2").obstacles == ()


def test_a_critical_scene_that_is_left_out_is_said_before_anything_runs(write):
    suite = write(
        'success_rate: 0.1, tiers: {"flat/*": critical}', scenes=f"{HERE}, hurdles/one_low_carpet"
    )
    assert api.check(suite).obstacles == ()
    forecast = api.check(suite, scenes=("hurdles/*",))
    assert forecast.left_out == (HERE,)
    assert forecast.obstacles == (
        f"critical scene {HERE} is left out, and the suite cannot pass without it",
    )


def test_too_few_rounds_against_a_baseline_are_said(monkeypatch):
    monkeypatch.chdir(ROOT)
    changes = {"policy": "go1-parkour", "baseline": "go1-act-rgb"}
    (told,) = api.check("hurdles", trials=1, **changes).obstacles
    assert told.startswith(
        "16 trials against baseline go1-act-rgb cannot exclude a drop of 0.1 even"
    )
    least = int(told.split("--trials ")[1].split()[0])
    assert least > 1
    assert api.check("hurdles", trials=least, **changes).obstacles == ()
    assert api.check("hurdles", trials=least - 1, **changes).obstacles
    assert api.check("hurdles", **changes).obstacles == ()


def test_a_bar_above_what_the_baseline_scores_is_said_before_anything_runs(
    monkeypatch, tmp_path, capsys
):
    monkeypatch.chdir(ROOT)
    hurdles = (ROOT / "suites" / "hurdles-state.yaml").read_text()
    assert "success_rate: 0.75" in hurdles
    suite = tmp_path / "hurdles-state.yaml"
    suite.write_text(hurdles.replace("success_rate: 0.75", "success_rate: 0.95"))
    options = ["--policy", "go1-parkour", "--baseline", "go1-parkour"]
    assert ends("check", suite, *options) == 0
    assert (
        "warning   gate.success_rate 0.95 is above the success of baseline go1-parkour, 0.943: "
        "a policy that is as good as the baseline does not pass"
    ) in capsys.readouterr().out
    assert ends("check", "hurdles-state", *options) == 0
    assert "warning" not in capsys.readouterr().out


# The scene of `real` is fetched first.
@pytest.mark.parametrize("name", sorted(set(available("suites")) - {"real"}))
def test_every_shipped_suite_can_pass(name, monkeypatch):
    monkeypatch.chdir(ROOT)
    assert api.check(name).obstacles == ()


def test_the_docs_have_suites_of_which_each_with_a_bar_can_pass(tmp_path, monkeypatch):
    assert "suite.md my-suite.yaml" in IN_DOCS
    monkeypatch.chdir(tmp_path)
    for name, text in IN_DOCS.items():
        # Some have scenes or robots of the reader.
        if "gate:" in text and not re.search(r"\./(?!policies)", text):
            (tmp_path / "suite.yaml").write_text(text)
            assert api.check(tmp_path / "suite.yaml", policy="go1-parkour").obstacles == (), name


@pytest.mark.parametrize("perturb", [{}, {"push": [1.0]}, {"friction": [0.6, 1.25]}])
@pytest.mark.parametrize("scenes", [[HERE], [HERE, "hurdles/one_low_carpet"], ["gaps/*"]])
def test_suites_that_are_written_ready_can_pass(tmp_path, scenes, perturb):
    path = tmp_path / "ready.yaml"
    write_ready_suite(path, "ready", scenes, perturb=perturb)
    forecast = api.check(path)
    assert forecast.suite.gate.success_rate == 0.75
    assert forecast.obstacles == ()
    # Also after a trial or two that failed: it has twice the trials that are needed.
    cells = len(forecast.suite.perturb.cells)
    strata = len(forecast.scenes) * cells
    assert forecast.suite.trials >= 2 * trials_to_pass(forecast.suite.gate, strata) > 0


def test_a_suites_baseline_counts_for_its_own_policy_however_that_is_named(monkeypatch, tmp_path):
    monkeypatch.chdir(ROOT)
    own = ROOT / "policies" / "go1-act-rgb"
    for policy in (None, "go1-act-rgb", str(own), str(own / "policy.yaml")):
        plan = api.plan("hurdles", policy=policy)
        assert plan.own_policy
        assert plan.against.info.name == "go1-act-rgb"
    other = api.plan("hurdles", policy="go1-parkour")
    assert (other.own_policy, other.against) == (False, None)
    assert api.plan("hurdles", policy="go1-parkour", baseline="go1-parkour").against is not None
    # With other weights for its card it is a candidate in the place of the suite's own.
    weights = tmp_path / "other.onnx"
    weights.write_bytes((own / "policy.onnx").read_bytes())
    assert api.plan("hurdles", checkpoint=weights).against is not None


def test_a_first_run_of_an_own_policy_is_judged_by_the_bar_and_says_how_to_save_a_baseline(
    monkeypatch, tmp_path
):
    monkeypatch.chdir(ROOT)
    options = {"scenes": ("hurdles/one_low_carpet",), "trials": 1, "record": "none"}
    first = api.run(
        "hurdles-state", policy="stand", in_process=True, out=tmp_path / "first", **options
    )
    told = (
        "max_drop 0.1 was ignored: stand has no baseline in this suite (go1-parkour is for the "
        "suite's own policy); `nw-eval baseline save hurdles-state --policy stand` saves one, "
        "--baseline names it"
    )
    for judged in (first, api.report(first.folder), api.judge(first.folder)):
        assert judged.verdict.against is None
        assert told in judged.verdict.reasons
        page = judged.page or first.page
        assert "in 1 of the suite's 16 scenes" in page.read_text()
    assert (first.info.own_policy, len(first.info.left_out)) == (False, 15)
    again = api.run(resume=first.folder, in_process=True)
    assert (again.info.own_policy, again.verdict.against) == (False, None)


def test_merged_parts_say_which_of_the_suites_scenes_they_have(write, tmp_path):
    suite = write("success_rate: 0.5", trials=2, scenes=f"{HERE}, hurdles/one_low_carpet")
    suite.write_text(suite.read_text() + "episode: {duration: 0.2}\nrecord: none\n")
    parts = [
        api.run(
            suite, policy="stand", scenes=("flat/*",), shard=f"{k}/2", in_process=True,
            out=tmp_path / f"{k}",
        ).folder
        for k in (1, 2)
    ]  # fmt: skip
    for part in parts:
        assert "1 trial in 1 of the suite's 2 scenes" in (part / "report.md").read_text()
    merged = api.merge(parts, out=tmp_path / "merged")
    assert merged.info.left_out == ("hurdles/one_low_carpet",)
    assert "2 trials in 1 of the suite's 2 scenes" in merged.page.read_text()
