"""The runs that README and Get started show end in the words that such rows end in today."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from nw_eval import cli
from nw_eval.suite import load_suite
from nw_gate.results.baseline import baseline_mean, mean_of
from nw_gate.results.baseline_file import find_baseline, read_baseline

ROOT = Path(__file__).parents[2]
START = ROOT / "docs" / "index.md"


def shown(page: Path, verdict: str) -> str:
    """The block of a page that has this verdict."""
    text = page.read_text(encoding="utf-8")
    blocks = re.findall(r"^```\w*\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    (found,) = [
        block for block in blocks if re.search(f"^{verdict}( by [a-z ]+)? · ", block, re.MULTILINE)
    ]
    return found


def timeless(text: str) -> str:
    return re.sub(r"· [\d.]+ (s|min) on \d+ workers", "", " ".join(text.split()))


def test_the_verdict_of_make_run_is_of_the_committed_baseline() -> None:
    text = timeless(shown(START, "PASS"))
    baseline, gate = (
        read_baseline(find_baseline("go1-act-rgb", suite="hurdles")),
        load_suite("hurdles").gate,
    )
    starts = [start for cell in baseline.panels[0].by_stratum.values() for start in cell]
    completed = sum(start.completed for start in starts)
    assert f"success {baseline_mean(baseline):.3f} (bar {gate.success_rate:g})" in text
    assert (
        f"completed {completed} of {len(starts)} trials in {len(baseline.manifest.key.scenes)}"
        in text
    )
    (worst,) = re.findall(r"below the bar by itself: (\S+) completed .*? success (\d\.\d+)", text)
    means = {scene: mean_of(found) for (scene, _), found in baseline.panels[0].by_stratum.items()}
    below = {scene: f"{mean:.3f}" for scene, mean in means.items() if mean < gate.success_rate}
    assert below == {worst[0]: worst[1]}


@pytest.mark.nightly
def test_make_run_prints_what_the_page_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    with pytest.raises(SystemExit) as left:
        cli.main(["run", str(ROOT / "suites" / "hurdles.yaml"), "--no-cache", "--out", "run"])
    assert left.value.code == 0
    assert timeless(shown(START, "PASS")) in timeless(capsys.readouterr().out)


def test_the_regression_is_shown_alike_and_of_the_shipped_suite_and_baseline() -> None:
    block = shown(ROOT / "README.md", "REGRESSED")
    assert block == shown(START, "REGRESSED")
    assert max(map(len, block.splitlines())) <= 120
    text = " ".join(block.splitlines())
    gate = load_suite("gaps").gate
    assert f"drop 0.332 (max_drop {gate.most_drop:g})" in text
    assert f"success 0.594 (bar {gate.success_rate:g})" in text
    assert f"With at most {16 * gate.rounds_for(16)} trials, " in text
    # What stands in the table that explains it is in it.
    words = re.findall(r"^\| `([^`]+)` \|", START.read_text(encoding="utf-8"), re.MULTILINE)
    assert words[:1] == ["success 0.594"]
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
    if "computes slightly different results" in " ".join(printed.split()):
        pytest.skip("the bits here are not the baseline's: its own policy runs beside the other")

    assert timeless(" ".join(wanted)) in timeless(printed)
