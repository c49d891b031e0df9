"""What reports say of a comparison with a baseline."""

import re
from dataclasses import replace
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from nw_eval.reporting.console import draw, print_summary
from nw_eval.reporting.markdown import render_markdown
from nw_eval.reporting.tables.scenes import scenes_table
from nw_eval.reporting.tables.trials import parting, worst_table
from nw_eval.suite import Gate
from nw_gate.absolute import judge
from nw_gate.baseline.combine import combined
from nw_gate.results.baseline import Start
from nw_gate.stats.interval import Interval
from nw_gate.verdict import Recheck, SceneDrop

FINE = SceneDrop(
    scene="a",
    perturbation=(("friction", 0.6),),
    tier="supporting",
    baseline=0.9,
    candidate=0.95,
    trials=5,
    evidence=0.3,
    named=False,
)
TOY = SceneDrop(
    scene="toy",
    tier="informational",
    baseline=0.5,
    candidate=0.0,
    trials=5,
    evidence=1.0,
    named=False,
)


@pytest.fixture
def found(regressed):
    """That comparison, with a scene that did not regress and one that does not count besides."""
    return replace(regressed, scenes=(FINE, *regressed.scenes, TOY))


@pytest.fixture
def page(make_row, make_run):
    """The report of a run that was compared so; nothing ran where `rows` is 0."""

    def make(found, *, rows=3, **facts):
        trials = [make_row("a", index, 4) for index in range(rows)]
        verdict = combined(judge(trials, Gate(), {"a": rows}, against=found), found)
        run = make_run({"a": rows}, suite={"name": "hurdles", "seed": 7}, **facts)
        return render_markdown(run, trials, verdict, Path("reports/x"))

    return make


def table(text):
    (section,) = re.findall(r"## Success by scene\n\n(.*?)\n## ", text, re.DOTALL)
    lines = [line for line in section.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[:1] + lines[2:]]


def test_the_first_lines_say_what_fell_by_how_much_and_what_the_gate_can_see(page, found):
    first, _, second, *_ = page(found).splitlines()
    assert first.startswith(
        "# REGRESSED by the baseline comparison, critical scene hurdles/three_low \u00b7 "
        "completed 3 of 3 trials in 1 scene \u00b7 success 1.000 (no bar), drop 0.250 (max_drop "
        "0.1) in the 80 trials compared \u00b7 "
    )
    assert second.endswith(
        "On this seed set (seed 7) success is exactly 1.000. With at most 320 trials, this gate "
        "flags a 0.1 regression in 90 % of cases and a 0.05 regression in 36 %, and passes an "
        "equally good policy in \\> 99 % (simulated)."
    )


def test_scenes_are_shown_side_by_side_what_fell_first_and_what_does_not_count_last(page, found):
    text = page(found)
    assert table(text) == [
        ["scene", "tier", "trials", "success", "baseline", "change", "regressed", "worse from"],
        ["hurdles/three_low", "critical", "5", "0.400", "0.950", "-0.550", "yes", "waypoint 2"],
        ["a friction 0.6", "supporting", "5", "0.950", "0.900", "+0.050", "", ""],
        ["toy", "informational", "5", "0.000", "0.500", "-0.500", "", ""],
    ]  # fmt: skip
    # Two scenes count: each shares half of 1 %.
    said = "At 200 or more the scene is reported as regressed (2 scenes share an error of 1 %)."
    assert said in text
    assert "At 4 or more, PASS is withheld." in text


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, "new initial states in these scenes: scenes and states were drawn at random from"),
        ({"claim": "panel", "starts": 40}, "the claim is of these only"),
        ({"basis": "control"}, "its policy ran beside the candidate, from the same initial states"),
        ({"basis": "fresh"}, "the candidate met new ones, and the baseline's mean is of 60"),
        ({}, "that of the scenes of these trials, some easy and some hard by chance"),
    ],
)  # fmt: skip
def test_every_report_names_its_initial_states(page, changes, words, found):
    how_sure = page(replace(found, **changes)).split("## How sure")[1]
    assert words in how_sure.replace("\\", "")
    assert (
        "A drop of 0.1 or more against the baseline passes with probability at most 5 %" in how_sure
    )
    assert "dropped by at most 0.02, in no scene by more than 0.1." in how_sure
    assert "The verdict is on this checkpoint, not on its training recipe" in how_sure


def test_a_report_says_whether_its_panel_is_pinned_or_fresh(page, found):
    pinned, fresh = page(found), page(found, panel="fresh")
    assert "The seed set is pinned, the suite's own." in pinned
    assert "confirm it with --seed-set fresh" in pinned
    assert "The seed set is fresh: it follows from what the checkpoint computes" in fresh
    assert "On this fresh seed set (seed 7) success is exactly" in fresh
    assert "same initial states), fresh |" in " ".join(fresh.split())


def test_the_page_of_the_same_policy_says_what_was_taken_over_and_what_ran_again(page, found):
    again = Recheck(compared=2, ran=2, equal=True, differing=(), taken_over=True)
    same = replace(
        found, basis="same", word="PASS", trials=1, drop=None, interval=None, curve=None,
        again=again, reasons=("the same policy",),
    )  # fmt: skip
    text = page(same)
    over = "same policy as baseline shipped: 2 trials re-run and identical"
    assert text.startswith(f"# PASS \u00b7 {over} \u00b7 completed ")
    assert "Results that were not re-run are those of the baseline's file." in text
    # All results are the baseline's: nothing changed, and how trials ended is of those that ran.
    assert not {"baseline", "change"} & {*table(text)[0]}
    assert "Of the 3 trials of this run; the other results are the baseline's." in text
    assert "A drop of 0.1 or more" not in text
    other = replace(same, again=replace(again, equal=False, taken_over=False))
    text = page(other)
    assert "baseline, so no result is reused (2 trials re-run)" in text
    assert "Results that were not re-run" not in text


def test_a_policy_that_failed_by_itself_counts_as_nothing_and_the_page_says_so(
    make_row, make_run, found
):
    failed = {"outcome": "policy_failed", "end_reason": "action", "error_type": "policy_error"}
    rows = [make_row("a", 0, 2, **failed)]
    for against, end in ((None, "then."), (found, "then; against the baseline they count as 0.")):
        verdict = replace(judge(rows, Gate(), {"a": 1}), against=against)
        text = render_markdown(make_run({"a": 1}), rows, verdict, Path("x"))
        assert f"results, and count with the waypoints reached until {end}" in text


def test_without_a_baseline_nothing_of_one_is_said(make_row, make_run):
    rows = [make_row("a", 0, 4)]
    text = render_markdown(make_run({"a": 1}), rows, judge(rows, Gate(), {"a": 1}), Path("x"))
    assert "baseline" not in text


def test_the_terminal_shows_the_same_table_and_the_verdict_last(make_row, make_run, found):
    rows = [make_row("a", index, 4) for index in range(3)]
    verdict = combined(judge(rows, Gate(), {"a": 3}, against=found), found)
    stream = StringIO()
    console = Console(file=stream, width=140)
    print_summary(console, make_run({"a": 3}), rows, verdict, Path("x"))
    text = stream.getvalue()
    assert re.search(r"three_low +critical +5 +0.400 +0.950 +-0.550 +yes", text)
    assert text.rstrip().endswith("* 3 trials ran and no bar was judged: the suite sets no "
                                  "gate.success_rate")  # fmt: skip


def test_a_scene_that_is_compared_has_the_interval_of_its_drop_and_no_other(page, found):
    scenes = tuple(replace(item, interval=Interval(-0.1, 0.3)) for item in found.scenes)
    text = page(replace(found, scenes=scenes))
    header, *lines = table(text)
    # A change is the drop turned round, and so are its ends.
    assert header[6] == "change, 95 % lower, 99 % upper"
    note = "Per-scene interval (95 % lower, 99 % upper), not corrected for the number of scenes."
    assert text.count(note) == 1
    assert {line[6] for line in lines} == {"-0.30 to 0.10"}
    assert [sum(" to " in cell for cell in line) for line in lines] == [1, 1, 1]
    strict = page(replace(found, scenes=scenes, alpha_regr=0.005, alpha_pass=0.1))
    assert table(strict)[0][6] == "change, 90 % lower, 99.5 % upper"


def test_a_scene_that_met_no_trial_beside_a_control_shows_no_baseline(page, found):
    fell = found.scenes[1]
    none = {"baseline": None, "candidate": None, "trials": 0}
    unmet = replace(TOY, scene="unmet", tier="supporting", **none)
    text = page(replace(found, basis="control", scenes=(fell, unmet)))
    line = next(line for line in table(text) if line[0] == "unmet")
    assert line == ["unmet", "supporting", "0", "none", "", "none", "", "", ""]


def test_a_worst_trial_says_what_the_baseline_s_policy_did_from_the_same_start(make_row):
    fell = make_row("a", 0, 1, trial_id="t")
    times = {"waypoint_times": (1.0, 3.14, 4.0, 5.0), "sim_s": 6.26}
    completed = make_row("a", 0, 4, **times)
    passed = "The baseline's policy passed waypoint 2"
    assert parting(fell, completed) == f"{passed} at 3.1 s and completed at 6.3 s."
    baseline = Start(
        scene="a", task="hurdles", seed_index=0, success=0.5, completed=False,
        waypoints_reached=2, waypoints_total=4, outcome="fell", end_reason="roll", trajectory="",
    )  # fmt: skip
    # A baseline does not say when.
    assert parting(fell, baseline) == f"{passed} and fell."
    either = replace(baseline, waypoints_reached=1)
    assert parting(fell, either).startswith("The baseline's policy did not pass waypoint 2 either")
    less = replace(baseline, waypoints_reached=0)
    assert parting(fell, less).startswith("The baseline's policy reached 0 of 4 waypoints")
    assert parting(fell, None) == ""
    named = worst_table([fell], Path("x"), rivals={"t": completed})
    assert named.columns[4:] == ("baseline", "replay")
    assert "baseline" not in worst_table([fell], Path("x")).columns


def test_a_partly_compared_scene_names_the_trials_of_its_change(make_row, found):
    rows = [make_row("hurdles/three_low", index, 2) for index in range(8)]
    verdict = judge(rows, Gate(), {"hurdles/three_low": 8}, against=found)
    shown = scenes_table(replace(verdict, against=found))
    line = dict(zip(shown.columns, shown.rows[0], strict=True))
    assert (line["trials"], line["success"], line["change"]) == ("8", "0.500", "-0.550 (5 trials)")


def test_short_words_of_a_table_stay_whole_in_a_terminal_of_120_columns(found):
    fell = found.scenes[1]
    named = replace(fell, scene="hurdles/three_grassy_courtyard", tier="supporting")
    stream = StringIO()
    against = replace(found, scenes=(named, fell))
    verdict = replace(judge([], Gate(), {}), against=against)
    draw(Console(file=stream, width=120), scenes_table(verdict))
    assert re.search(r"three_grassy_courtyard +supporting +5 ", stream.getvalue())
