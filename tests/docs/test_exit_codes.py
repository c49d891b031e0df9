"""The table of exit codes in Get started is what happens: each of its rows, for real."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from nw_eval import api, cli
from nw_eval.cli.verbs.table import EXIT_CODES as HELP
from nw_gate.results.baseline import Panel
from nw_gate.results.baseline_file import baseline_of_run, write_baseline
from nw_gate.verdict import EXIT_CODES

START = Path(__file__).parents[2] / "docs" / "index.md"

SUITE = """\
nw-eval: 1
name: quick
robot: go1
policy: {policy}
trials: {trials}
seed: 5
episode: {{duration: {duration}}}
scenes: [flat/carpet_room]
record: none
{gate}
"""


def promised() -> list[tuple[int, str]]:
    """Code and verdict of every row of the table."""
    table = START.read_text(encoding="utf-8").split("| code | verdict |")[1].split("\n\n")[0]
    return [
        (int(code), word.strip())
        for code, word in re.findall(r"^\| (\d+) \|([^|]*)\|", table, re.MULTILINE)
    ]


def write(policy: str = "stand", trials: int = 1, duration: float = 0.2, gate: str = "") -> str:
    Path("quick.yaml").write_text(
        SUITE.format(policy=policy, trials=trials, duration=duration, gate=gate)
    )
    return "./quick.yaml"


def bar(value: float) -> str:
    return f"gate: {{success_rate: {value}}}"


def pass_(_: pytest.MonkeyPatch) -> list[str]:
    return ["run", write("go1-parkour", 3, 6.0, bar(0.2)), "--out", "run"]


def ran(_: pytest.MonkeyPatch) -> list[str]:
    return ["run", write(), "--out", "run"]


def regressed(_: pytest.MonkeyPatch) -> list[str]:
    return ["run", write(trials=4, gate=bar(0.9)), "--out", "run"]


def misused(_: pytest.MonkeyPatch) -> list[str]:
    return ["run", write(policy="stnad"), "--out", "run"]


def inconclusive(_: pytest.MonkeyPatch) -> list[str]:
    return ["run", write(gate=bar(0.5)), "--out", "run"]


def infrastructure(_: pytest.MonkeyPatch) -> list[str]:
    # The published protocol lets who stands still stand for a minute: long enough on any machine
    # for the supervisor, which looks ten times a second, to come by.
    suite = write(duration=60.0)
    Path(suite).write_text(Path(suite).read_text() + "protocol: neverwhere-2026\n")
    return ["run", suite, "--time-limit", "0.01", "--out", "run"]


def not_comparable(_: pytest.MonkeyPatch) -> list[str]:
    api.run(write(), out=Path("run"))
    return ["run", write(), "--policy", "go1-parkour", "--resume", "run"]


def invalid(_: pytest.MonkeyPatch) -> list[str]:
    suite = write(
        trials=6, gate="gate: {success_rate: 0.5, max_drop: 0.1, rounds: 2, least_starts: 1}"
    )
    kept = api.run(suite, out=Path("kept"))
    baseline = baseline_of_run(kept.rows, kept.info, name="stand", card="stand")
    # As if standing had got there, by the same bits, on some other machine.
    there = {"success": 1.0, "completed": True, "outcome": "completed"}
    machine = {**baseline.panels[0].machine, "cpu": "elsewhere"}
    starts = tuple(
        replace(start, waypoints_reached=start.waypoints_total, **there)
        for start in baseline.panels[0].starts
    )
    info = baseline.manifest.panels[0].model_copy(update={"machine": machine})
    manifest = baseline.manifest.model_copy(update={"panels": (info,)})
    forged = replace(baseline, manifest=manifest, panels=(Panel(machine=machine, starts=starts),))
    write_baseline(Path("stand.parquet"), forged)
    compared = ["--policy", "go1-parkour", "--baseline", "stand.parquet"]
    return ["run", suite, *compared, "--out", "run"]


def interrupted(patch: pytest.MonkeyPatch) -> list[str]:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt  # As Python's own handler of SIGINT does.

    patch.setattr("nw_eval.api.run", interrupt)
    return ["run", write()]


WAYS = {
    (0, "PASS"): pass_,
    (0, "RAN"): ran,
    (1, "REGRESSED"): regressed,
    (2, ""): misused,
    (3, "INCONCLUSIVE"): inconclusive,
    (4, "INFRASTRUCTURE"): infrastructure,
    (5, "INVALID"): invalid,
    (130, ""): interrupted,
}


def test_the_table_has_the_rows_that_are_tried_here_and_every_verdict() -> None:
    rows = promised()
    assert rows == list(WAYS)
    assert {(code, word) for word, code in EXIT_CODES.items()} <= set(rows)


def words_of(out: str) -> list[str]:
    """Return the words of verdicts that lines begin with, whatever made them."""
    heads = [line.split(" · ")[0].split(" by ")[0] for line in out.splitlines()]
    return [head for head in heads if head in EXIT_CODES]


def test_the_same_table_is_in_readme_get_started_and_outcomes_and_help_has_its_words() -> None:
    pages = [START.parents[1] / "README.md", START, START.parent / "reference" / "outcomes.md"]
    head = "| code | verdict | meaning |"
    tables = [page.read_text("utf-8").split(head)[1].split("\n\n")[0] for page in pages]
    assert len(set(tables)) == 1
    said = " ".join(HELP.split())
    for code, word, meaning in re.findall(
        r"^\| (\d+) \| (\w*) ?\| (.*) \|$", tables[0], re.MULTILINE
    ):
        listed = {"RAN": "0 PASS, or RAN", "INFRASTRUCTURE": "4 infrastructure error"}
        listed |= {"INVALID": "5 invalid comparison"}
        words = re.split("[;:]", meaning)[0]
        assert listed.get(word, f"{code} {word or words}") in said
        assert word not in listed or word == "RAN" or listed[word] == f"{code} {words}"


def test_a_run_that_cannot_be_resumed_ends_without_a_verdict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as left:
        cli.main(not_comparable(monkeypatch))
    assert left.value.code == 5
    out, err = capsys.readouterr()
    assert not words_of(out)
    assert err.strip()
    assert "Traceback" not in err


@pytest.mark.parametrize(("code", "word"), promised())
def test_every_row_of_the_table_happens(
    code: int,
    word: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    arguments = WAYS[code, word](monkeypatch)
    with pytest.raises(SystemExit) as left:
        cli.main(arguments)
    assert left.value.code == code
    out, err = capsys.readouterr()
    assert words_of(out) == ([word] if word else [])
    if word:
        report = Path("run", "report.md").read_text(encoding="utf-8")
        assert re.match(f"# {word}( by [^·]+)? · ", report)
    else:
        assert err.strip()
        assert "Traceback" not in err


def test_a_policy_that_does_nothing_in_the_smoke_suite_never_passes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as left:
        cli.main(["run", "smoke", "--policy", "stand", "-n", "1", "--record", "none"])
    shown = capsys.readouterr().out
    assert left.value.code == 0
    assert "success 0.000 (not judged)" in shown
    assert "completed 0 of 2 trials" in shown
    assert "PASS" not in shown
