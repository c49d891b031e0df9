import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from nw_base.digest import digest_of
from nw_base.errors import StoreError
from nw_eval.reporting.markdown import render_markdown, write_report
from nw_eval.reporting.tables import tasks_table
from nw_eval.suite import Gate
from nw_gate.absolute import judge
from nw_gate.results.provenance import PolicyInfo
from nw_gate.stats.betting import lower_bound, upper_bound

FOLDER = Path("reports/run one")
BAR = Gate(success_rate=0.75)


@pytest.fixture
def render(make_run):
    def make(rows, planned, gate=BAR, **run):
        info = make_run(planned, **run)
        return render_markdown(info, rows, judge(rows, gate, planned), FOLDER)

    return make


def section(text, title):
    """Cells of the table under a title, header first."""
    body = text.split(f"## {title}\n", 1)[1].split("\n## ", 1)[0]
    lines = [line for line in body.splitlines() if line.startswith("|")]
    cells = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]
    return [cells[0], *cells[2:]]


def test_the_first_line_is_the_verdict_and_the_second_what_it_speaks_of(make_row, render):
    rows = [make_row(scene, k, 4 - (k == 0)) for scene in ("a", "b") for k in range(20)]
    text = render(rows, {"a": 20, "b": 20}, suite={"seed": 7})
    first, _, second = text.splitlines()[:3]
    assert first.startswith(
        "# PASS · completed 38 of 40 trials in 2 scenes · success 0.988 (bar 0.75)"
    )
    assert first.endswith(" · success 0.988 (bar 0.75) · 60 s on 2 workers")
    assert second == (
        "The bounds apply to new initial states in these scenes. On this seed set (seed 7) success "
        "is exactly 0.988."
    )


def test_a_score_of_zero_claims_no_sight_of_drops(make_row, render):
    rows = [make_row("a", k, 0) for k in range(40)]
    for gate, word in ((BAR, "REGRESSED"), (Gate(), "RAN")):
        first, _, second = render(rows, {"a": 40}, gate).splitlines()[:3]
        assert first.startswith(f"# {word}")
        assert "completed 0 of 40 trials" in first
        assert "new initial states in these scenes" in second
        assert "worse" not in second
        assert "drops" not in second


def test_what_completed_is_told_of_the_trials_that_count(make_row, render):
    rows = [make_row("a", k, 4) for k in range(3)] + [make_row("toy", k, 0) for k in range(2)]
    toy = Gate(success_rate=0.75, tiers={"toy": "informational"})
    assert "completed 3 of 3 counted trials; 5 ran in 2 scenes" in render(
        rows, {"a": 3, "toy": 2}, toy
    )
    assert "completed 3 of 3 counted trials; 3 of 9 ran in 1 scene" in render(rows[:3], {"a": 9})
    # Where some are missing, the seed set's success is not known.
    assert "seed set" not in render(rows[:3], {"a": 9}).splitlines()[2]


def test_how_sure_one_may_be_is_told_as_far_as_it_applies(make_row, render):
    rows = [make_row(scene, k, 4) for scene in ("a", "b") for k in range(20)]
    planned = {"a": 20, "b": 20}
    plain = render(rows, planned).split("## How sure")[1]
    assert "new initial states in these scenes" in plain
    assert "Picking the best of many checkpoints favours luck" in plain
    for absent in ("critical", "neverwhere", "worse"):
        assert absent not in plain
    critical = Gate(success_rate=0.75, tiers={"*": "critical"})
    told = render(rows, planned, critical, suite={"protocol": "neverwhere-2026"})
    told = told.split("## How sure")[1]
    assert "2 critical scenes can flag a regression alone" in told
    assert "a probability of at most 10 %" in told
    assert "scenes are not independent of each other" in told
    assert "How sure" not in render([], {"a": 3})


def test_two_suites_of_one_panel_are_told_apart_and_the_panel_explains_itself(make_row, render):
    rows = [make_row("a", 0, 4)]
    facts = [
        dict(section(render(rows, {"a": 1}, suite={"name": name}), "Provenance")[1:])
        for name in ("hurdles", "smoke")
    ]
    assert facts[0]["suite"] != facts[1]["suite"]
    assert facts[0]["seed set"] == facts[1]["seed set"]
    assert facts[0]["seed set"].startswith("`aaaaaaaaaaaa` (same robot, protocol, seed")


def test_a_run_without_results_says_that_it_saw_nothing(render):
    first, _, second = render([], {"a": 3}).splitlines()[:3]
    assert first == "# INFRASTRUCTURE · 0 of 3 trials in 0 scenes · 60 s on 2 workers"
    assert "No trial has a result" in second


def test_scenes_are_listed_worst_first_with_intervals_around_their_means(make_row, render):
    rows = [make_row("good", k, 4) for k in range(4)] + [make_row("bad", k, k) for k in range(4)]
    header, bad, good = section(render(rows, {"good": 4, "bad": 4}), "Success by scene")
    assert header == ["scene", "trials", "success", "95 % two-sided", "completed"]
    assert bad[:3] == ["bad", "4", "0.375"]
    assert good[:3] == ["good", "4", "1.000"]
    low, high = (float(end) for end in bad[3].split(" to "))
    assert low < 0.375 < high
    assert good[4:] == ["4 of 4"]


def test_each_mean_has_one_interval_and_its_header_says_of_what_it_is(make_row, render):
    rows = [make_row("good", k, 4) for k in range(4)] + [make_row("bad", k, k) for k in range(4)]
    page = render(rows, {"good": 4, "bad": 4})
    header, *lines = section(page, "Success by scene")
    assert [name for name in header if "%" in name] == ["95 % two-sided"]
    said = "Per-scene interval (95 % two-sided), not corrected for the number of scenes."
    assert page.count(said) == 1
    assert [sum(" to " in cell for cell in line) for line in lines] == [1, 1]


def test_the_only_scene_and_the_only_cell_have_the_interval_of_the_verdict_and_no_other(
    make_row, render
):
    """Their means are the run's, whose bounds stand in the first lines."""
    icy = [(("friction", 0.4),)] * 4
    rows = [make_row("a", k, k, perturbation=cell) for k, cell in enumerate(icy)]
    text = render(rows, {"a": 4})
    assert section(text, "Success by scene") == [
        ["scene", "trials", "success", "completed"],
        ["a", "4", "0.375", "0 of 4"],
    ]
    assert section(text, "Success by perturbation") == [
        ["perturbation", "trials", "success"],
        ["friction 0.4", "4", "0.375"],
    ]


def test_tasks_have_bounds_like_the_verdicts_and_the_only_task_has_those_of_the_verdict(make_row):
    rows = [make_row("a", k, k, task="gaps") for k in range(4)]
    only = judge(rows, BAR, {"a": 4})
    table = tasks_table(rows, only)
    assert table.columns == ("task", "scenes", "trials", "success")
    assert [bar.interval for bar in table.bars if bar is not None] == [only.interval]
    rows += [make_row("b", k, 4, task="ramps") for k in range(4)]
    table = tasks_table(rows, judge(rows, BAR, {"a": 4, "b": 4}))
    assert table.columns[4] == "95 % lower, 95 % upper"
    assert table.note == (
        "Per-task interval (95 % lower, 95 % upper), not corrected for the number of tasks."
    )
    groups = [np.array([0.0, 0.25, 0.5, 0.75])]
    low, high = lower_bound(groups, 0.95), upper_bound(groups, 0.95)
    assert table.rows[0] == ("gaps", "1", "4", "0.375", f"{low:.2f} to {high:.2f}")


def test_cells_of_one_trial_in_a_scene_have_bounds_like_the_verdicts_with_room_above_the_mean(
    make_row, render
):
    rows = [
        make_row(scene, k, reached, perturbation=(("friction", friction),))
        for k, friction in enumerate((0.4, 1.0))
        for scene, reached in (("a", 4), ("b", 4), ("c", 1), ("d", 4))
    ]
    text = render(rows, dict.fromkeys("abcd", 2))
    header, *cells = section(text, "Success by perturbation")
    assert header[3] == "95 % lower, 95 % upper"
    assert (
        "Per-cell interval (95 % lower, 95 % upper), not corrected for the number of cells." in text
    )
    groups = [np.array([value]) for value in (1.0, 1.0, 0.25, 1.0)]
    expected = f"{lower_bound(groups, 0.95):.2f} to {upper_bound(groups, 0.95):.2f}"
    assert [cell[3] for cell in cells] == [expected] * 2
    assert upper_bound(groups, 0.95) > 0.8125 + 0.05


def test_a_scene_that_lacks_trials_says_so(make_row, render):
    text = render([make_row("a", 0, 4), make_row("a", 1, None)], {"a": 4, "b": 2})
    _, empty, partial = section(text, "Success by scene")
    assert empty[:3] == ["b", "0 of 2", "none"]
    assert partial[:2] == ["a", "1 of 4"]
    assert section(text, "Errors")[1] == ["a-001", "crashed", "1", "signal 11"]
    assert "* 4 trials missing (a 2, b 2); --resume runs them" in text


def test_failures_of_the_policy_and_of_the_machine_are_told_apart(make_row, render):
    failed = {
        "outcome": "policy_failed",
        "end_reason": "diverged",
        "error_text": "physics diverged",
    }
    rows = [make_row("a", 0, 4), make_row("a", 1, 1, **failed), make_row("a", 2, None)]
    text = render(rows, {"a": 3})
    assert section(text, "Policy failures")[1:] == [
        ["a-001", "diverged", "0.250", "physics diverged"]
    ]
    assert section(text, "Errors")[1:] == [["a-002", "crashed", "1", "signal 11"]]
    outcomes = {line[0].replace("\\", ""): line for line in section(text, "Outcomes")[1:]}
    assert outcomes["policy_failed"][1:4] == ["1", "33 %", "0.250"]
    assert "crashed (error)" in outcomes
    assert "Policy failures" not in render([make_row("a", 0, 4), make_row("a", 1, 2)], {"a": 2})


def test_the_worst_trials_come_with_a_command_that_a_shell_understands(make_row, render):
    rows = [make_row("hurdles/one", k, reached) for k, reached in enumerate((4, 2, 0, 3))]
    header, *worst = section(render(rows, {"hurdles/one": 4}), "Worst trials")
    assert header[-1] == "replay"
    assert [line[1] for line in worst] == ["0/4", "2/4", "3/4"]
    command = shlex.split(worst[0][-1].strip("`"))
    assert command == [
        "nw-eval",
        "replay",
        "reports/run one/mcap/hurdles/one/hurdles-one-002.mcap",
    ]


def test_a_long_list_is_cut_and_says_how_many_more_there_are(make_row, render):
    text = render([make_row("a", k, 1) for k in range(11)], {"a": 11})
    assert len(section(text, "Worst trials")) == 1 + 8
    assert "3 more are in trials.parquet." in text


def test_stages_add_up_to_the_time_of_all_workers(make_row, render):
    own = {"setup_s": 0.08, "sense_s": 0.08}
    rows = [make_row("a", k, 4, **own) for k in range(10)]
    rows.append(make_row("a", 10, 4, cached=True, wall_s=99.0))
    text = render(rows, {"a": 11})
    _, *stages = section(text, "Where the time went")
    # Ten trials of 2 s and 200 steps each: 0.08 + 0.08 + 1.0 + 0.1 + 0.5 + 0.2 s named, 0.04 left.
    # Two workers were there for 60 s.
    assert stages == [
        ["setup", "0.8", "0.40", "1 %"],
        ["sense", "0.8", "0.40", "1 %"],
        ["render", "10.0", "5.00", "8 %"],
        ["policy", "1.0", "0.50", "1 %"],
        ["physics", "5.0", "2.50", "4 %"],
        ["log", "2.0", "1.00", "2 %"],
        ["other", "0.4", "0.20", "0 %"],
        ["waiting", "100.0", "50.00", "83 %"],
    ]
    assert "11.0 trials per minute on 2 workers; 40 s simulated, 2.0 times real time" in text


def test_a_camera_out_of_the_captured_volume_is_flagged(make_row, render):
    rows = [make_row("a", 0, 4), make_row("a", 1, 4, coverage_min=0.2, coverage_mean=0.7)]
    assert section(render(rows, {"a": 2}), "Out of the captured volume")[1:] == [
        ["a-001", "0.20", "0.70", "completed"]
    ]
    assert "captured volume" not in render(rows[:1], {"a": 1})


def test_contacts_that_end_no_trial_are_counted_by_scene(make_row, render):
    rows = [
        make_row("a", 0, 4, contact_s=0.5),
        make_row("a", 1, 4, contact_s=0.75),
        make_row("a", 2, 4),
        make_row("b", 0, 4),
    ]
    goes_on = {"episode": {"contact_termination": False}}
    text = render(rows, {"a": 3, "b": 1}, suite=goes_on)
    assert section(text, "Contacts of head and trunk")[1:] == [
        ["a", "2 of 3", "1.25 s"],
        ["b", "0 of 1", "0.00 s"],
    ]
    # Where contacts end trials, the outcomes say it all.
    assert "Contacts of head" not in render(rows, {"a": 3, "b": 1})


def test_perturbations_get_a_table_of_their_own(make_row, render):
    rows = [
        make_row(
            "a", k, 4 if mu > 0.7 else 2, perturbation=(("friction", mu),), trial_id=f"{k}{mu}"
        )
        for k in range(3)
        for mu, reached in ((0.6, 2), (1.0, 4))
    ]
    _, slippery, rough = section(render(rows, {"a": 6}), "Success by perturbation")
    assert slippery[:3] == ["friction 0.6", "3", "0.500"]
    assert rough[:3] == ["friction 1", "3", "1.000"]


def test_words_from_outside_cannot_break_the_report(make_row, render):
    evil = "x | y\n## Fake title\n<script>alert(1)</script> `code` [a](http://b)"
    text = render([make_row("a", 0, None, error_text=evil), make_row("a", 1, 4)], {"a": 2})
    assert "\n## Fake title" not in text
    assert "<script>" not in text.replace("\\<", "")
    (row,) = section(text, "Errors")[1:]
    assert len(row) == 4


def test_provenance_names_what_ran(make_row, render):
    facts = dict(section(render([make_row("a", 0, 4)], {"a": 1}), "Provenance")[1:])
    assert facts["suite"] == f"suites/hurdles.yaml, `{digest_of({'name': 'hurdles'})[:12]}`"
    assert facts["policy"] == "go1-parkour, checkpoint `cccccccccccc`"
    assert facts["nw-eval"] == "0.1.0, commit `ffffffffffff` with changes"
    assert facts["versions"] == "mujoco 4.0.0"


def test_an_interrupted_run_says_so(make_row, render):
    text = render([make_row("a", 0, 4)], {"a": 2}, interrupted=True)
    assert "* the run was interrupted before its end" in text


def test_a_run_that_was_killed_does_not_pretend_to_a_cost(make_row, render):
    text = render([make_row("a", k, 4) for k in range(3)], {"a": 9}, finished=None, wall_s=0.0)
    assert text.splitlines()[0].endswith(" · not finished on 2 workers")
    # Three trials of 2 s on two workers take 3 s at least.
    assert "60.0 trials per minute" in text


def test_a_report_appears_whole_or_not_at_all(tmp_path):
    write_report(tmp_path / "report.md", "# x\n")
    assert (tmp_path / "report.md").read_text() == "# x\n"
    (tmp_path / "file").touch()
    with pytest.raises(StoreError, match="cannot write"):
        write_report(tmp_path / "file" / "report.md", "# x\n")


def test_a_policy_without_weights_is_not_shown_with_the_digest_of_nothing(make_row, render):
    rows = [make_row("a", 0, 4)]
    own = dict(section(render(rows, {"a": 1}), "Provenance")[1:])
    assert own["policy"] == "go1-parkour, checkpoint `cccccccccccc`"
    far = PolicyInfo(name="far", checkpoint_digest="dd" * 32, origin="served dddddddddddddddd")
    served = dict(section(render(rows, {"a": 1}, policy=far), "Provenance")[1:])
    assert served["policy"] == "far, served `dddddddddddddddd`"


EVIL = (
    "\x1b[2Ja\u202eb ::error::c ##[d] @maintainer see #12, GH-3, org/repo#4, www.evil.example, "
    "https://evil.example/x, a@b.example, &#64;maintainer <!-- hidden --> <b> `` | $x$ "
    + "y"
    * 5000
)


def test_strangers_words_notify_nobody_and_link_nowhere(make_row, render):
    rows = [
        make_row("a", 0, None, error_text=EVIL),
        make_row(f"s {EVIL[:300]}", 1, 2, end_reason=EVIL[:300]),
    ]
    text = render(rows, {"a": 1, rows[1].scene: 2}, policy=PolicyInfo(
        name=EVIL[:300], checkpoint_digest="cc" * 32
    ))  # fmt: skip
    assert not any(mark in text for mark in ("\x1b", "\u202e", "##[", "&#64;maintainer <"))
    # GitHub looks for names and addresses everywhere but in code: nothing of them is left there.
    plain = "\n".join(re.sub(r"`[^`]*`", "", line) for line in text.splitlines())
    for mark in ("@m", "@b", "#1", "#4", "GH-3", "www.", "://", "<!--", "<b>"):
        assert mark not in plain.replace("\\<", ""), mark
    assert "`@maintainer`" in text
    assert max(map(len, text.splitlines())) < 10_000


def test_a_forged_row_advises_no_command_outside_the_run(make_row, render):
    text = render(
        [make_row("a", k, 1, mcap_path=p) for k, p in enumerate(("/x", "../x"))], {"a": 2}
    )
    assert "nw-eval replay" not in text
