"""However many faults a suite, its scenes and its policy have, one look tells all of them."""

import pytest
from command_line import ends
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from nw_base.errors import PolicyError, SuiteError
from nw_eval import api
from nw_eval.cli.verbs.check import forecast_page
from nw_eval.suite import load_suite
from nw_places.entry import Entry
from nw_sim import catalogue

# What is right, and in its place: what is wrong, and what is said of it.
FAULTS = {
    "key": ("record: none", "recrod: none", "1: unknown key 'recrod'; did you mean 'record'?"),
    "value": ("trials: 1", "trials: 0", "1: trials: must be at least 1, got 0"),
    "duplicate": ("# nothing", "seed: 7", "1: duplicate key 'seed', first on line 6"),
    "scene": (
        "  - hurdles/three_low",
        "  - hurdles/three_lo",
        "5: no scene matches 'hurdles/three_lo'; did you mean 'hurdles/three_low'?",
    ),
    "glob": (
        "  - hurdles/*",
        "  - hurlde/*",
        "5: no scene matches 'hurlde/*'; did you mean 'hurdles",
    ),
    "missing folder": ("  - ./whole", "  - ./nowhere", "5: no scene matches './nowhere'"),
    "broken folder": (
        "  - ./other",
        "  - ./yard",
        "5: {folder}/yard/scene.yaml:1:1: 'task' is missing",
    ),
    "tier": (
        "    hurdles/three_low: critical",
        "    hurdles/three_hi: critical",
        "5: gate.tiers: the suite runs no scene 'hurdles/three_hi'; did you mean 'hurdles/three",
    ),
    "robot": ("robot: go1", "robot: go3", "1: unknown robot 'go3'; did you mean 'go"),
    "policy": (
        "policy: stand",
        "policy: stnad",
        "1: unknown policy 'stnad': no policy, folder or card has that name; did you mean",
    ),
}

SUITE = """\
nw-eval: 1
name: quick
robot: go1
policy: stand
trials: 1
seed: 5
# nothing
record: none
scenes:
  - hurdles/three_low
  - hurdles/*
  - ./whole
  - ./other
  - ./third
gate:
  tiers:
    hurdles/three_low: critical
    third: informational
"""

SCENE = """\
nw-scene: 1
name: {name}
task: hurdles
licence: CC0-1.0
trail: [[1, 0, 0]]
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with three good scenes beside a broken one."""
    folder = tmp_path_factory.mktemp("suites")
    for name in ("whole", "other", "third", "yard"):
        (folder / name).mkdir()
        text = SCENE.format(name=name)
        if name == "yard":
            text = text.replace("task: hurdles\n", "")
        (folder / name / "scene.yaml").write_text(text)
        (folder / name / "collision.yaml").write_text("boxes: []\n")
    return folder


def told(folder, names):
    """Write a suite with faults; return what is said as lines, and what was to be said."""
    lines = SUITE.splitlines()
    path = folder / "quick.yaml"
    wanted = []
    for name in names:
        right, wrong, said = FAULTS[name]
        line = lines.index(right)
        lines[line] = wrong
        wanted.append((line + 1, f"{path}:{line + 1}:{said.format(folder=folder)}"))
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(SuiteError) as caught:
        api.check(path)
    return str(caught.value).splitlines(), [said for _, said in sorted(wanted)]


def test_a_suite_without_faults_has_none(place):
    path = place / "quick.yaml"
    path.write_text(SUITE)
    assert "hurdles/three_low" in forecast_page(api.check(path))
    # A suite that was read already is as good as its file.
    assert api.plan(load_suite(path)).trials == api.plan(path).trials


@settings(
    deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(names=st.sets(st.sampled_from(sorted(FAULTS)), min_size=1))
def test_every_fault_is_told_once_in_order_with_its_place_and_the_nearest_name(place, names):
    said, wanted = told(place, names)
    assert len(said) == len(wanted), said
    for line, start in zip(said, wanted, strict=True):
        assert line.startswith(start)


def test_a_cards_faults_stand_beside_the_suites(place):
    card = place / "mine" / "policy.yaml"
    card.parent.mkdir()
    card.write_text("nw-policy: 1\nname: mine\nrobot: go1\nadaptor: zero\n")
    path = place / "quick.yaml"
    path.write_text(SUITE.replace("stand", "./mine").replace("record", "recrod"))
    with pytest.raises(SuiteError) as caught:
        api.check(path)
    first, *others = str(caught.value).splitlines()
    assert first.startswith(f"{path}:8:1: unknown key 'recrod'")
    assert others
    assert all(line.startswith(f"{card}:") for line in others)
    assert any("unknown key 'adaptor'; did you mean 'adapter'?" in line for line in others)
    # Where only the card is wrong, nothing is said of the suite.
    path.write_text(SUITE.replace("stand", "./mine"))
    with pytest.raises(PolicyError) as alone:
        api.check(path)
    assert str(alone.value).splitlines() == others


def test_a_policy_that_was_asked_for_is_not_the_suites_fault(place):
    path = place / "quick.yaml"
    path.write_text(SUITE)
    with pytest.raises(PolicyError, match="unknown policy 'stnad': no policy, folder or card"):
        api.check(path, policy="stnad")
    path.write_text(SUITE.replace("policy: stand", "policy: stnad"))
    assert "stand" in forecast_page(api.check(path, policy="stand"))


def test_a_robot_that_nobody_knows_is_one_fault(place):
    path = place / "quick.yaml"
    path.write_text(SUITE.replace("robot: go1", "robot: go3"))
    with pytest.raises(SuiteError) as caught:
        api.check(path)
    assert len(str(caught.value).splitlines()) == 1


def test_no_name_of_a_scene_is_too_odd_to_be_told(place):
    path = place / "quick.yaml"
    for pattern in ("x" * 1000, "a**b", "[", "a\\0b"):
        path.write_text(SUITE.replace("- ./whole", f'- "{pattern}"'))
        with pytest.raises(SuiteError) as caught:
            api.check(path)
        (line,) = str(caught.value).splitlines()
        assert line.startswith(f"{path}:12:5: no scene matches")


def test_suites_are_listed_with_what_they_run(capsys):
    assert ends("suites") == 0
    rows = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()}
    assert set(rows) >= {"all", "gaps", "hurdles", "ramps", "smoke", "stairs"}
    assert "16 scenes x 10  bar 0.75  go1-act-rgb + baseline  Hurdles: bars" in rows["hurdles"]
    assert rows["+"] == (
        "+ baseline: it counts for this policy of the suite; --baseline names one for others"
    )
    assert "2 scenes x 2    no bar" in rows["smoke"]
    assert all(len(line) < 130 for line in rows.values())


def test_listing_suites_builds_none_of_their_places(monkeypatch):
    def built(entry):
        raise AssertionError(f"{entry.name} was built")

    catalogue._built_in.cache_clear()
    monkeypatch.setattr(Entry, "scene", built)
    assert (64, 5) in {(suite.scenes, suite.trials) for suite in api.list_suites()}


def test_a_suite_with_problems_is_listed_with_the_first_of_them(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "suites").mkdir()
    (tmp_path / "suites" / "mine.yaml").write_text("nw-eval: 2\n")
    (mine,) = [suite for suite in api.list_suites() if suite.name == "mine"]
    assert "mine.yaml:1:1:" in str(mine.problem)


def test_two_suites_of_one_panel_are_told_apart_and_the_panel_is_explained():
    smoke, hurdles = (
        forecast_page(api.check(name)).splitlines()[:3] for name in ("smoke", "hurdles-state")
    )
    assert smoke[0].split(",")[-1] != hurdles[0].split(",")[-1]
    assert smoke[1:] == hurdles[1:]
    assert smoke[2].strip() == "suites with the same seed set use the same initial states"
