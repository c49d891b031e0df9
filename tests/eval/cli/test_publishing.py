"""Where verbs show the run that they judged; nothing of it changes how they end."""

import xml.etree.ElementTree as ET

import pytest
from command_line import ends

SUITE = """\
nw-eval: 1
name: tiny
robot: go1
policy: stand
trials: 1
seed: 7
episode: {duration: 0.2}
scenes:
  - flat/carpet_room
record: none
"""


@pytest.fixture
def step(tmp_path, monkeypatch):
    """A step of a job: its folder has what the runner would read of it."""
    for name in ("summary", "output"):
        (tmp_path / name).touch()
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(tmp_path / "summary"))
    monkeypatch.setenv("GITHUB_OUTPUT", str(tmp_path / "output"))
    monkeypatch.setenv("GITHUB_WORKSPACE", str(tmp_path))
    return tmp_path


def outputs(step):
    lines = (step / "output").read_text().splitlines()
    return {lines[k].split("<<")[0]: lines[k + 1] for k in range(0, len(lines), 3)}


def test_a_run_on_github_folds_its_progress_and_its_tables_and_writes_the_steps_files(
    step, capsys, monkeypatch
):
    (step / "suites").mkdir()
    (step / "suites" / "tiny.yaml").write_text(SUITE + "gate: {success_rate: 0.9}\n")
    monkeypatch.chdir(step)
    code = ends("run", "tiny", "--workers", 1, "--out", "reports/r")
    said = capsys.readouterr()
    assert said.err.startswith("::group::nw-eval run tiny\n")
    assert said.err.rstrip().endswith("::endgroup::")
    tables, _, rest = said.out.partition("::endgroup::\n")
    assert tables.startswith("::group::Tables\nSuccess by scene")
    assert rest.startswith("INCONCLUSIVE · completed 0 of 1 trial in 1 scene")
    errors = [line for line in rest.splitlines() if line.startswith("::")]
    assert errors == [line for line in errors if line.startswith("::error file=suites/tiny.yaml,")]
    assert ",line=11,title=INCONCLUSIVE%3A tiny::INCONCLUSIVE · completed" in errors[0]
    assert outputs(step) == {
        "verdict": "INCONCLUSIVE",
        "exit-code": "3",
        "success": "0.000000",
        "effect": "0.000000",
        "trials": "1",
        "report-path": "reports/r",
    }
    assert code == 3
    assert (
        (step / "summary").read_text().startswith("# INCONCLUSIVE: tiny, stand\n\nINCONCLUSIVE · c")
    )


def test_github_is_told_nothing_where_nobody_wants_it(step, regressed_run, capsys):
    assert ends("gate", regressed_run, "--no-github") == 1
    assert "::" not in capsys.readouterr().out
    assert (step / "summary").read_text() == (step / "output").read_text() == ""
    assert ends("gate", regressed_run, "--no-github", "--github") == 2
    assert "exclude each other" in capsys.readouterr().err


def test_away_from_github_it_is_told_what_is_asked_for_and_misses_the_files(regressed_run, capsys):
    assert ends("gate", regressed_run) == 1
    assert "::" not in capsys.readouterr().out
    assert ends("gate", regressed_run, "--github") == 1
    said = capsys.readouterr()
    assert "\n::error title=REGRESSED%3A tiny::REGRESSED" in said.out
    assert said.err.splitlines() == [
        f"warning: no step {what}: the environment has no {name}; run it as a step of a job"
        for what, name in (("summary", "GITHUB_STEP_SUMMARY"), ("outputs", "GITHUB_OUTPUT"))
    ]


@pytest.mark.parametrize("verb", ["gate", "report"])
def test_a_surface_that_cannot_be_written_is_a_warning_and_the_others_are_written(
    step, regressed_run, capsys, verb
):
    (step / "summary").unlink()
    (step / "summary").mkdir()
    nowhere = step / "output" / "junit.xml"
    comment = step / "comment.md"
    assert ends(verb, regressed_run, "--junit", nowhere, "--comment", comment) == 1
    junit, summary = capsys.readouterr().err.splitlines()
    assert junit.startswith(f"warning: no JUnit file: cannot write {nowhere}: File exists")
    assert summary.startswith("warning: no step summary: cannot write GITHUB_STEP_SUMMARY: Is a di")
    assert outputs(step)["verdict"] == "REGRESSED"
    assert comment.read_text().startswith("<!-- nw-eval: tiny -->\n# REGRESSED: tiny, stand\n")


def test_a_summary_that_is_full_is_a_warning(step, regressed_run, capsys):
    (step / "summary").write_bytes(b"x" * 2**20)
    assert ends("gate", regressed_run) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("warning: no step summary: the page needs more than the 0 bytes")
    assert (step / "summary").stat().st_size == 2**20


def test_whatever_a_surface_raises_is_a_warning(step, regressed_run, capsys, monkeypatch):
    def fail(*_):
        raise RecursionError("a\x1b[2J\n::error::b")

    monkeypatch.setattr("nw_eval.reporting.junit.junit_xml", fail)
    assert ends("gate", regressed_run, "--junit", step / "junit.xml") == 1
    assert (
        capsys.readouterr().err == "warning: no JUnit file: RecursionError: a\\x1b[2J ::error::b\n"
    )


def test_an_error_before_a_verdict_leaves_no_earlier_one_to_be_taken_for_its_own(
    step, regressed_run, capsys
):
    files = ("--junit", step / "junit.xml", "--comment", step / "comment.md")
    assert ends("gate", regressed_run, *files) == 1
    (step / "output").write_text("")
    (step / "suite.yaml").write_text(SUITE.replace("trials: 1", "trials: none"))
    capsys.readouterr()
    assert ends("run", step / "suite.yaml", *files) == 2
    said = capsys.readouterr()
    assert "::error file=suite.yaml,line=5,col=1,title=nw-eval::" in said.out
    assert outputs(step) == {"verdict": "", "exit-code": "2"}
    assert not (step / "comment.md").exists()
    (error,) = ET.parse(step / "junit.xml").iter("error")
    assert error.get("type") == "SuiteError"


def test_a_report_that_cannot_be_written_is_4_and_keeps_the_rows(step, regressed_run, capsys):
    rows = (regressed_run / "trials.parquet").read_bytes()
    out = step / "output" / "report.md"
    assert ends("report", regressed_run, "--out", out, "--junit", step / "junit.xml") == 4
    # Two pages lie beside each other; either is the first that cannot be written.
    assert f"error: cannot write {out.with_suffix('')}." in capsys.readouterr().err
    assert outputs(step) == {"verdict": "", "exit-code": "4"}
    assert (regressed_run / "trials.parquet").read_bytes() == rows
    assert ET.parse(step / "junit.xml").getroot().get("errors") == "1"
