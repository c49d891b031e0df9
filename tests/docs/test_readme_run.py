"""The runs that README and Get started show end in the words that such rows end in today."""

from __future__ import annotations

import re
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from nw_eval import cli
from nw_eval.built_in.splits import split_of
from nw_eval.catalogue import names
from nw_eval.gate.baseline.combine import judge_run
from nw_eval.reporting.console import print_summary
from nw_eval.results.bank import bank_mean, mean_of
from nw_eval.results.bank_file import find_bank, read_bank
from nw_eval.results.provenance import CodeInfo, MachineInfo, PolicyInfo, RunInfo, SceneInfo
from nw_eval.results.row import Row
from nw_eval.suite import load_suite

ROOT = Path(__file__).parents[2]
START = ROOT / "docs" / "index.md"

# The trials of `make run` that did not complete: waypoints reached by each.
FALLEN = {
    "one_high_stone_plaza": [0, 0],
    "three_crates_workshop": [2, 3],
    "three_grassy_courtyard": [1],
    "three_high_wood_hall": [0, 0, 0, 1, 1, 1, 1, 2, 2, 3],
    "two_beams_yard_night": [1, 1, 1, 2],
    "two_foam_office": [2],
    "two_logs_park": [2],
}
WAYPOINTS = {"one": 2, "two": 3, "three": 4}


def shown(page: Path, verdict: str) -> str:
    """The block of a page that has this verdict."""
    blocks = page.read_text(encoding="utf-8").split("```\n")[1::2]
    (found,) = [block for block in blocks if f"{verdict} · " in block]
    return found


def scenes() -> list[str]:
    return [name for name in names() if name.startswith("hurdles/")]


def row(scene: str, index: int, reached: int, total: int) -> Row:
    return Row(
        trial_id=f"{scene.replace('/', '-')}-{index:03d}",
        suite="hurdles",
        scene=scene,
        task="hurdles",
        robot="go1",
        seed_index=index,
        seed=index,
        policy="go1-act-rgb",
        status="ok",
        outcome="completed" if reached == total else "collided",
        end_reason="",
        completed=reached == total,
        success=reached / total,
        waypoints_reached=reached,
        waypoints_total=total,
        steps=200,
        sim_s=4.0,
        physics_s=0.5,
        render_s=1.0,
        policy_s=0.1,
        log_s=0.2,
        wall_s=2.0,
        checkpoint_digest="cc" * 32,
        scene_digest="dd" * 32,
    )


def rows() -> list[Row]:
    made: list[Row] = []
    for scene in scenes():
        name = scene.removeprefix("hurdles/")
        total = WAYPOINTS[name.split("_")[0]]
        fallen = FALLEN.get(name, [])
        reached = [*fallen, *[total] * (10 - len(fallen))]
        made += [row(scene, index, count, total) for index, count in enumerate(reached)]
    return made


def test_the_scenes_and_the_verdict_of_make_run_are_what_is_printed_today() -> None:
    wanted = [line.rstrip() for line in shown(START, "PASS").splitlines()]
    suite = load_suite("hurdles")
    (wall,) = re.findall(r" scenes · ([\d.]+) (s|min) on (\d+) workers", "\n".join(wanted))
    seconds, workers = float(wall[0]) * {"s": 1, "min": 60}[wall[1]], int(wall[2])
    run = RunInfo(
        id="run",
        started="2026-11-21T20:03:38Z",
        finished="2026-11-21T20:04:02Z",
        wall_s=seconds,
        suite_file="suites/hurdles.yaml",
        suite=suite.model_dump(by_alias=True, mode="json"),
        suite_digest=suite.digest,
        policy=PolicyInfo(name="go1-act-rgb", checkpoint_digest="cc" * 32),
        scenes={
            name: SceneInfo(digest="dd" * 32, task="hurdles", trials=10, split=split_of(name))
            for name in scenes()
        },
        workers=workers,
        code=CodeInfo(version="0.1.0", digest="ee" * 32),
        machine=MachineInfo(host="ci", cpu="", cores=2, system="", python=""),
        versions={},
    )
    console = Console(file=StringIO(), width=120)
    gate = suite.gate.model_copy(update={"max_drop": None, "baseline": None})
    print_summary(console, run, rows(), judge_run(rows(), run, gate, None), Path("run"))
    printed = [line.rstrip() for line in console.file.getvalue().splitlines()]
    told = [line for line in wanted if line.startswith(" hurdles/")]
    assert len(told) == 3, "the largest drops, then an ellipsis"
    bank = read_bank(find_bank("go1-act-rgb", suite="hurdles"))
    dropped: list[tuple[float, str]] = []
    for line in printed:
        if line.startswith(" hurdles/"):
            scene, success = line.split()[0], float(line.split()[4])
            mean = mean_of(bank.panels[0].by_stratum[scene, ()])
            change = success - mean
            dropped.append((change, " ".join(f"{line} {mean:.3f} {change:+.3f}".split())))
    # Both columns of the baseline are rounded by themselves.
    assert [" ".join(line.split()) for line in told] == [line for _, line in sorted(dropped)][:3]
    means = [line for line in printed if line.startswith("Mean success: ")]
    assert means == [line for line in wanted if line.startswith("Mean success: ")] != []
    # Against its own baseline a verdict says two things more; without, what its seeds are worth.
    text = " ".join(wanted[_verdict(wanted) :])
    own = "baseline go1-act-rgb is the same policy · 160 run again and equal · "
    nothing = "* the same policy as the baseline go1-act-rgb: 160 run again and equal "
    assert own in text
    assert nothing in text
    without = re.sub(
        r"; in this seed set \(seed \d+\) it is known: \d\.\d+\.",
        ".",
        " ".join(printed[_verdict(printed) :]),
    )
    assert without == text.replace(own, "").replace(nothing, "")


def _verdict(lines: list[str]) -> int:
    (found,) = [index for index, line in enumerate(lines) if line.startswith("PASS ·")]
    return found


def test_the_regression_is_shown_alike_and_of_the_shipped_suite_and_baseline() -> None:
    block = shown(ROOT / "README.md", "REGRESSED")
    assert block == shown(START, "REGRESSED")
    assert max(map(len, block.splitlines())) <= 120
    text = " ".join(block.splitlines())
    mean = bank_mean(read_bank(find_bank("go1-parkour", suite="gaps")))
    gate = load_suite("gaps").gate
    assert f"baseline go1-parkour {mean:.3f}, drop 0.253 " in text
    assert f", bar {gate.success_rate:g})" in text
    assert f"in 19 of {16 * gate.rounds} trials · " in text
    # What stands in the table that explains it is in it.
    words = re.findall(r"^\| `([^`]+)` \|", START.read_text(encoding="utf-8"), re.MULTILINE)
    assert words[:1] == ["success 0.662"]
    assert all(word in text for word in words[:6])


@pytest.mark.nightly
def test_the_regression_is_what_its_command_prints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    command, *wanted = shown(ROOT / "README.md", "REGRESSED").splitlines()
    with pytest.raises(SystemExit) as left:
        cli.main([*command.removeprefix("$ nw-eval ").split(), "--no-cache", "--out", "run"])
    assert left.value.code == 1
    printed = capsys.readouterr().out
    if "ran beside the candidate" in printed:
        pytest.skip("the bits here are not the baseline's: its own policy runs beside the other")

    def timeless(text: str) -> str:
        return re.sub(r"· [\d.]+ (s|min) on \d+ workers", "", " ".join(text.split()))

    assert timeless(" ".join(wanted)) in timeless(printed)
