"""A robot's results beside those of runs, from a CSV to what can be said of them."""

import json
import subprocess
import sys
from math import inf

import pytest
from command_line import ends

import nw_eval
from nw_base.errors import IncomparableError, StoreError, UsageError
from nw_gate.limits.ladder import Ladder
from nw_gate.limits.limit import Limit
from nw_gate.results.baseline import (
    BaselineKey,
    BaselinePolicy,
    BaselineResults,
    Manifest,
    Panel,
    PanelInfo,
    Start,
)
from nw_gate.results.baseline_file import write_baseline

SCENES = {"hurdles/a": "11" * 32, "hurdles/b": "22" * 32}
MACHINE = {"cpu": "znver4 1f0c77a2"}
HEADING = "policy,scene,trials,success\n"


def save(folder, name, completed, **changes):
    """Save a baseline of ten starts a scene, of which so many were completed in each."""
    key = BaselineKey(
        suite_digest="aa" * 32, seed=1, protocol="strict", scenes=SCENES, simulator={}
    ).model_copy(update=changes)
    starts = tuple(
        Start(
            scene=scene,
            task="hurdles",
            seed_index=index,
            success=float(index < count),
            completed=index < count,
            waypoints_reached=int(index < count),
            waypoints_total=1,
            outcome="completed" if index < count else "fell",
            end_reason="",
            trajectory="0" * 16,
        )
        for scene, count in zip(SCENES, completed, strict=True)
        for index in range(10)
    )
    panel = PanelInfo(machine=MACHINE, saved="2026-11-22T10:00:00Z", by="anna", rows_digest="dd")
    manifest = Manifest(
        name=name,
        suite="tiny",
        starts=10,
        key=key,
        policy=BaselinePolicy(name="walker", card_digest="bb", checkpoint_digest="cc"),
        panels=(panel,),
    )
    baseline = BaselineResults(manifest=manifest, panels=(Panel(machine=MACHINE, starts=starts),))
    path = folder / f"{name}.parquet"
    write_baseline(path, baseline)
    return path


@pytest.fixture
def baselines(tmp_path):
    """Five policies, of .1 to .9 in the simulator, .0 or .2 apart between their scenes."""
    return [
        save(tmp_path, f"p{k}", done)
        for k, done in enumerate([(0, 2), (3, 3), (6, 4), (7, 7), (9, 9)])
    ]


def csv(tmp_path, text):
    path = tmp_path / "real.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_five_policies_are_compared_over_the_scenes_that_they_met(baselines, tmp_path):
    real = csv(
        tmp_path,
        HEADING
        + "p0,hurdles/a,10,0.1\np0,hurdles/b,10,0.3\n"
        + "".join(f"p{k},hurdles/a,{10 * k},0.{2 * k}\n" for k in range(1, 5)),
    )
    found = nw_eval.sim2real(real, baselines)
    assert {each.policy: each.value for each in found.gaps} == pytest.approx(
        {"p0": 0.1 - 0.2, "p1": 0.3 - 0.2, "p2": 0.6 - 0.4, "p3": 0.7 - 0.6, "p4": 0.9 - 0.8}
    )
    figures = {each.name: each for each in found.figures}
    # By hand: .2 .2 .4 .6 .8 on the robot and .1 .3 .6 .7 .9 simulated: no order is violated.
    assert figures["mmrv"].value == 0.0
    # scipy 1.17.1, pearsonr.
    assert figures["pearson"].value == pytest.approx(0.9485769101954464, rel=1e-12)
    assert figures["pearson"].perfect.mean < 1.0


@pytest.mark.parametrize(
    "text",
    [
        HEADING.replace(",", ";") + "p0;hurdles/a;20;0,75\np4;hurdles/b;20;0.6\n",
        HEADING.replace(",", "\t") + "p0\thurdles/a\t20\t0.75\np4\thurdles/b\t20\t0.6\n",
        HEADING.title() + "p0,hurdles/a,20.0,75%\np4,hurdles/b,20.0,60 %\n",
        "," + HEADING + "0,p0,hurdles/a,20,0.75\n,,,,\n1,p4,hurdles/b,20,0.6\n\n",
    ],
    ids=["semicolons", "tabs", "percent", "an index"],
)
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_csv_of_a_spreadsheet_is_read(baselines, tmp_path, text, encoding):
    real = tmp_path / "real.csv"
    real.write_text(text, encoding=encoding)
    found = nw_eval.sim2real(real, baselines)
    assert {each.policy: each.value for each in found.gaps} == pytest.approx(
        {"p0": 0.0 - 0.75, "p4": 0.9 - 0.6}
    )


def test_two_policies_give_gaps_and_no_correlation(baselines, tmp_path, capsys):
    real = csv(tmp_path, HEADING + "p0,hurdles/a,20,0.75\np4,hurdles/b,20,0.6\n")
    assert not ends("sim2real", real, *baselines)
    printed = capsys.readouterr().out
    assert "nothing can be said of rank or correlation from 2 policies" in printed
    assert "Pearson" not in printed
    assert "p4                    +0.300" in printed


def test_the_terminal_has_the_figures_beside_a_perfect_simulators(baselines, tmp_path, capsys):
    lines = "".join(f"p{k},hurdles/a,10,{x}\n" for k, x in enumerate((0.3, 0.2, 0.4, 0.9, 0.7)))
    assert not ends("sim2real", str(csv(tmp_path, HEADING + lines)), *baselines)
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    (figure,) = [row for row in rows if row[:1] == ["MMRV"]]
    # By hand: p0 and p1 swap .1, p3 and p4 swap .2.
    assert figure[1] == "0.120"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("policy,scene,success\n", "lacks the column trials; write a heading"),
        (HEADING, "has no results"),
        ("", "lacks the column policy"),
        (HEADING + "p0,hurdles/a,0,0.5\n", r"real\.csv:2:1: trials '0' is not a whole number"),
        (HEADING + "p0,hurdles/a,ten,0.5\n", "trials 'ten' is not a whole number"),
        (HEADING + "p0,hurdles/a,10,nan\n", "success 'nan' is not between 0 and 1"),
        (HEADING + "p0,hurdles/a,10,75\n", "success '75' is not between 0 and 1"),
        (HEADING + "p0,hurdles/a,10\n", "success '' is not between 0 and 1"),
        (HEADING + ",hurdles/a,10,1\n", "it names no policy or no scene"),
        (HEADING + 2 * "p0,hurdles/a,10,1\n", r"csv:3:1: policy 'p0' in scene 'hurdles/a' is"),
        (HEADING + "q,hurdles/a,10,1\n", r"csv:2: policy 'q' is that of no run; known: p0, "),
        (HEADING + "walker,hurdles/a,10,1\n", r"policy 'walker' may be .*p0.* or .*p1"),
        (HEADING + "p0,hurdles/c,10,1\n", r"p0\.parquet has no result in scene 'hurdles/c'; did"),
        (HEADING + 'p0,"hurdles/a,10,1\n', "is not a CSV"),
        (HEADING + "p0,hurdles/a,10,0,8\n", r"csv has more cells in line 2 than in its heading"),
        (HEADING + "p0,hurdles/a,10.5,0.8\n", r"trials '10\.5' is not a whole number"),
        (HEADING.replace(",", ";") + "p0;hurdles/a;1.000;0,8\n", r"trials '1\.000' is not a whole"),
        ("policy,scene,trials,success,Success\n", "has success twice"),
    ],
)
def test_a_csv_that_cannot_be_used_is_named_with_its_line(baselines, tmp_path, text, message):
    with pytest.raises(UsageError, match=message):
        nw_eval.sim2real(csv(tmp_path, text), baselines)


def test_an_invalid_csv_and_invalid_runs_are_usage_errors(baselines, tmp_path):
    with pytest.raises(UsageError, match=r"cannot read .*nowhere"):
        nw_eval.sim2real(tmp_path / "nowhere.csv", baselines)
    with pytest.raises(UsageError, match="is not a CSV"):
        nw_eval.sim2real(baselines[0], baselines)
    with pytest.raises(UsageError, match="no run to compare the robot with"):
        nw_eval.sim2real(csv(tmp_path, HEADING), [])


def test_simulators_that_differ_are_not_one_simulator(baselines, tmp_path):
    other = save(tmp_path, "late", (9, 9), simulator={"mujoco": "4.0.1"})
    with pytest.raises(IncomparableError, match=r"its mujoco is 4\.0\.1, there none"):
        nw_eval.sim2real(csv(tmp_path, HEADING + "p0,hurdles/a,10,1\n"), [*baselines, other])


def test_agreement_imports_no_simulation(baselines, tmp_path):
    code = (
        "import sys, nw_eval; nw_eval.sim2real(sys.argv[1], sys.argv[2:]); "
        "print({'mujoco', 'torch', 'numba', 'onnxruntime', 'matplotlib'} & {*sys.modules})"
    )
    real = csv(tmp_path, HEADING + "p0,hurdles/a,10,1\n")
    done = subprocess.run(
        [sys.executable, "-c", code, str(real), *map(str, baselines)],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "set()\n"


RUNGS = {"bars": (0.1, 0.2, 0.3, 0.4, 0.5), "clearance": (0.7, 0.6, 0.5, 0.4)}


def save_limits(folder, limits):
    """Save limits.json of policies that complete 40 trials at one rung and none at the next."""
    entries = []
    for policy, ladder, cleared in limits:
        rungs = RUNGS[ladder]
        done = [(cleared, True)] * 40 if cleared >= 0 else []
        failed = [(cleared + 1, False)] * 40 if cleared + 1 < len(rungs) else []
        limit = Limit(
            ladder=Ladder(name=ladder, rungs=rungs, unit="m"),
            share=0.5,
            confidence=0.95,
            width=1,
            trials=(*done, *failed),
            staked=len(done) + len(failed),
        )
        entry = {"policy": policy, "ladder": ladder, "limit": limit.as_dict(), "run": "bars/1"}
        entries.append(entry)
    folder.mkdir()
    text = json.dumps({"nw-limits": 1, "limits": entries})
    (folder / "limits.json").write_text(text, encoding="utf-8")
    return folder


@pytest.fixture
def limits(tmp_path):
    """The limits of five policies on bars, and of the first one under boards."""
    return save_limits(
        tmp_path / "limits",
        [*((f"p{k}", "bars", k - 1) for k in range(1, 6)), ("p1", "clearance", 1)],
    )


def test_a_limit_of_the_robot_is_within_the_bounds_of_the_simulated_one(limits, tmp_path):
    real = csv(tmp_path, "policy,ladder,limit\np2,bars,0.25\np1,clearance,0.55\n")
    bars, clearance = nw_eval.sim2real(real, [limits]).gaps
    # p2 clears 0.2 m and not 0.3 m: 0.25 m is midway.
    assert (bars.value, bars.unit) == (pytest.approx(0.0, abs=0.005), "m")
    assert (bars.interval.low, bars.interval.high) == pytest.approx((-0.05, 0.05))
    # p1 clears 0.6 m of clearance and not 0.5 m.
    assert clearance.value == pytest.approx(0.0, abs=0.005)
    assert (clearance.interval.low, clearance.interval.high) == pytest.approx((-0.05, 0.05))


def test_bounds_of_both_worlds_give_all_differences_and_a_bound_that_lacks_leaves_it_open(
    limits, tmp_path
):
    real = csv(
        tmp_path,
        "policy;ladder;lower;upper\np2;bars;0,30;0,40\np3;bars;0,35;\np5;bars;0,3;0,4\n",
    )
    both, no_upper, all_cleared = nw_eval.sim2real(real, [limits / "limits.json"]).gaps
    assert both.value == pytest.approx(0.25 - 0.35, abs=0.005)
    assert (both.interval.low, both.interval.high) == pytest.approx((0.2 - 0.4, 0.3 - 0.3))
    assert no_upper.interval == (-inf, pytest.approx(0.4 - 0.35))
    assert all_cleared.interval == (pytest.approx(0.5 - 0.4), inf)


def test_five_limits_are_ranked_as_success_is(limits, tmp_path, capsys):
    values = (0.12, 0.24, 0.22, 0.4, 0.5)
    lines = "".join(f"p{k},bars,{x}\n" for k, x in enumerate(values, 1))
    real = csv(tmp_path, "policy,ladder,limit\n" + lines)
    found = nw_eval.sim2real(real, [limits])
    figures = {each.name: each for each in found.figures}
    # By hand: p2 and p3 swap; 0.02 m of a ladder of 0.4 m is .05, for two of five policies.
    assert figures["mmrv"].value == pytest.approx(2 * 0.05 / 5)
    # Spearman with one swap of neighbours among five: 1 - 6 * 2 / (5 * 24).
    assert figures["spearman"].value == pytest.approx(0.9)
    assert 0.0 <= figures["mmrv"].perfect.mean <= figures["mmrv"].perfect.worst
    assert not ends("sim2real", real, limits)
    printed = capsys.readouterr().out
    assert "limit: simulator less robot" in printed
    assert "p5      bars" in printed
    assert "at least" in printed
    assert not ends("sim2real", real, limits, "--json")
    saved = json.loads(capsys.readouterr().out)
    assert (saved["score"], saved["gaps"][4]["interval"]["high"]) == ("limit", None)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("policy,ladder\n", "lacks the column lower; write a heading `policy,ladder,limit` or"),
        ("policy,limit\n", "lacks the column ladder"),
        ("policy,ladder,limit\n", "has no results"),
        ("policy,ladder,limit\np1,bars,\n", r"real\.csv:2:1: it has no limit"),
        ("policy,ladder,limit\np1,bars,high\n", "limit 'high' is not a number"),
        ("policy,ladder,limit\np1,bars,inf\n", "limit 'inf' is not a number"),
        ("policy,ladder,limit\n,bars,0.2\n", "it names no policy or no ladder"),
        ("policy,ladder,limit\n" + 2 * "p1,bars,0.2\n", r"csv:3:1: policy 'p1' on ladder 'bars'"),
        ("policy,ladder,limit\np9,bars,0.2\n", r"csv:2: policy 'p9' has no limit in the simul"),
        ("policy,ladder,limit\np1,bar,0.2\n", r"p1 has no limit on ladder 'bar'; did you mean"),
        ("policy,ladder,lower,upper\np1,bars,0.3,0.2\n", "lower 0.3 was cleared and is harder"),
        ("policy,ladder,lower,upper\np1,clearance,0.4,0.5\n", "lower 0.4 was cleared and is har"),
        ("policy,ladder,lower,upper\np1,bars,,\n", "it has no limit"),
    ],
)
def test_limits_of_a_robot_that_cannot_be_used_are_named_with_their_line(
    limits, tmp_path, text, message
):
    with pytest.raises(UsageError, match=message):
        nw_eval.sim2real(csv(tmp_path, text), [limits])


def test_limits_are_not_mixed_with_runs_scores_or_each_other(limits, baselines, tmp_path):
    real = csv(tmp_path, "policy,ladder,limit\np1,bars,0.2\n")
    with pytest.raises(UsageError, match=r"limits holds limits, and .*p0\.parquet does not"):
        nw_eval.sim2real(real, [limits, baselines[0]])
    with pytest.raises(UsageError, match="--score slip with limits"):
        nw_eval.sim2real(real, [limits], score="slip")
    again = save_limits(tmp_path / "again", [("p1", "bars", 2)])
    with pytest.raises(UsageError, match=r"the limit of p1 on bars is in .*; name one of them"):
        nw_eval.sim2real(real, [limits, again])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "cannot be read"),
        ("[]", "cannot be read"),
        ("{}", "lacks 'nw-limits'"),
        ('{"nw-limits": 2, "limits": []}', "its version is 2, not 1"),
        ('{"nw-limits": 1, "limits": [{"policy": "p", "ladder": "b"}]}', "lacks 'limit'"),
    ],
)
def test_damaged_limits_are_named_with_how_to_renew_them(limits, tmp_path, text, message):
    (limits / "limits.json").write_text(text, encoding="utf-8")
    real = csv(tmp_path, "policy,ladder,limit\np1,bars,0.2\n")
    with pytest.raises(StoreError, match=message):
        nw_eval.sim2real(real, [limits])
