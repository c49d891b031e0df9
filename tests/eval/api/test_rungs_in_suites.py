"""A rung is a scene of a suite like any other: its name is safe wherever a scene's name goes."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pyarrow.parquet as pq
import pytest

from nw_eval import api, cli
from nw_eval.reporting.tables.trials import view_link
from nw_eval.suite import load_suite
from nw_gate.results.moment_link import read_link

SUITE = """\
nw-eval: 1
name: rungs
robot: go1
policy: stand
trials: 1
seed: 1
episode: {duration: 0.3}
scenes: [hurdles/bar@0.340, "gaps/beam@0.2~1", hurdles/one_low_carpet]
record: none
gate:
  success_rate: 0.5
  tiers: {"hurdles/bar@0.34": critical}
"""
NAMES = ("hurdles/bar@0.34", "gaps/beam@0.2~1", "hurdles/one_low_carpet")


@pytest.fixture(scope="module")
def suite(tmp_path_factory):
    path = tmp_path_factory.mktemp("rungs") / "rungs.yaml"
    path.write_text(SUITE)
    return path


@pytest.fixture(scope="module")
def ran(suite):
    """The folder of a run of the suite, with what a CI job asks for."""
    out = suite.parent / "out"
    asked = ["--junit", str(suite.parent / "junit.xml"), "--comment", str(suite.parent / "c.md")]
    with pytest.raises(SystemExit) as ended:
        cli.main(["run", str(suite), "--in-process", "--out", str(out), "--github", *asked])
    assert ended.value.code == 3  # One trial of a policy that stands decides nothing.
    return out


def test_trials_logs_and_rows_bear_the_name(ran):
    rows = pq.read_table(ran / "trials.parquet").to_pylist()
    assert {row["scene"] for row in rows} == set(NAMES)
    assert {row["trial_id"] for row in rows} >= {"hurdles-bar@0.34-000", "gaps-beam@0.2~1-000"}
    for row in rows:
        assert (ran / row["mcap_path"]).is_file()
    log = ran / "mcap" / "hurdles" / "bar@0.34" / "hurdles-bar@0.34-000.mcap"
    assert log.is_file()
    assert api.replay(log).differences == ()


def test_reports_name_it_and_lead_to_its_trials(ran, suite):
    cases = {case.get("name") for case in ET.parse(suite.parent / "junit.xml").iter("testcase")}
    assert set(NAMES) <= cases
    assert "hurdles/bar@0.34" in (suite.parent / "c.md").read_text()
    page = (ran / "report.html").read_text()
    assert "hurdles/bar@0.34" in page
    report = api.report(ran)
    row = next(row for row in report.rows if row.scene == "hurdles/bar@0.34")
    link = view_link(row, "out")
    found = read_link(link.removeprefix("http://localhost:8720"))
    assert found is not None
    assert found.trial == row.trial_id


def test_a_scene_option_selects_it(suite):
    plan = api.plan(suite, scenes=("hurdles/bar@0.34",))
    assert [scene.name for scene in plan.scenes] == ["hurdles/bar@0.34"]
    assert load_suite(suite).gate.tier("hurdles/bar@0.34") == "critical"
