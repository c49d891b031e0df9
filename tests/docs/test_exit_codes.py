"""The README's table of exit codes is what happens: each of its rows, for real."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from nw_eval import api, cli
from nw_eval.gate import EXIT_CODES

README = Path(__file__).parents[2] / "README.md"

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
    table = README.read_text(encoding="utf-8").split("| code | verdict |")[1].split("\n\n")[0]
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
    return ["run", write(), "--time-limit", "0.01", "--out", "run"]


def not_comparable(_: pytest.MonkeyPatch) -> list[str]:
    api.run(write(), out=Path("run"))
    return ["run", write(), "--policy", "go1-parkour", "--resume", "run"]


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
    (5, ""): not_comparable,
    (130, ""): interrupted,
}


def test_the_table_has_the_rows_that_are_tried_here_and_every_verdict() -> None:
    rows = promised()
    assert rows == list(WAYS)
    # INVALID is the word of comparisons, which there are none of yet.
    assert {(code, word) for word, code in EXIT_CODES.items()} - set(rows) == {(5, "INVALID")}


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
    words = [
        line.split(" · ")[0] for line in out.splitlines() if line.split(" · ")[0] in EXIT_CODES
    ]
    assert words == ([word] if word else [])
    if word:
        report = Path("run", "report.md").read_text(encoding="utf-8")
        assert report.startswith(f"# {word} · ")
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
    assert "RAN · success 0.000" in shown
    assert "completed 0 of 2 trials" in shown
    assert "PASS" not in shown
