"""Axes, splat formats and reporters of packages: found, refused, and part of what a trial is."""

import io
from contextlib import redirect_stderr, redirect_stdout

import pytest

import nw_base.plugins
import nw_eval
import nw_splat.files
from nw_base.errors import PluginError, SceneError, SuiteError, UsageError
from nw_base.plugins import (
    AXES,
    REPORTERS,
    SENSORS,
    SPLAT_FORMATS,
    PluginWarning,
    identity_of,
    known_or_raise,
)
from nw_eval import api
from nw_eval.cli import main
from nw_eval.suite import json_schema, load_suite, new_suite
from nw_gate.results.provenance import read_run_info
from nw_policies.bundle import load_bundle
from nw_scenes.folder import load_folder
from nw_sim.axes import AXES as BUILT_IN
from nw_sim.axes import Axis, SweptAxis
from nw_splat.files import read_splat, write_splat

GAIN = """
from nw_eval import Axis

def change(setup, value):
    return setup.with_strength(value)

AXIS = Axis(name="gain", description="Of the motors.", neutral=1.0, low=0.1, high=2.0,
            slider=(0.5, 1.5, 0.1), unit="1", change=change)
"""
SUITE = """\
nw-eval: 1
name: gained
robot: go1
policy: stand
trials: 1
seed: 1
scenes: [hurdles/one_low_carpet]
episode: {duration: 0.5}
perturb: {gain: [0.5, 1.0]}
"""
POINTS = """
import numpy as np
from nw_eval import Gaussians, SplatFormat

def read(path):
    n = path.stat().st_size
    return Gaussians(means=np.zeros((n, 3)), log_scales=np.zeros((n, 3)),
                     quats=np.ones((n, 4)), opacity_logits=np.ones(n), sh=np.zeros((n, 1, 3)))

FORMAT = SplatFormat(name="pts", description="points", read=read)
"""


@pytest.fixture
def gain(package):
    return package("gainer", AXES, {"gain": "gainer:AXIS"}, GAIN)


@pytest.fixture
def suite(tmp_path, gain):  # noqa: ARG001
    path = tmp_path / "gained.yaml"
    path.write_text(SUITE)
    return path


def command(*words):
    """Run a command as typed; return its exit code and what it said."""
    said = io.StringIO()
    with redirect_stdout(said), redirect_stderr(said), pytest.raises(SystemExit) as ended:
        main(list(words))
    return ended.value.code, said.getvalue()


def test_a_suite_names_an_axis_of_a_package_and_its_version_is_part_of_its_digest(suite, package):
    first = load_suite(suite)
    assert first.plugins == {"axes.gain": "gainer 1.0"}
    assert first.perturb.cells == ((("gain", 0.5),), (("gain", 1.0),))
    package("gainer", AXES, {"gain": "gainer:AXIS"}, GAIN, version="1.1")
    second = load_suite(suite)
    assert second.plugins == {"axes.gain": "gainer 1.1"}
    assert first.digest != second.digest
    # What a run has saved is what it was, whatever is installed now.
    assert new_suite(first.model_dump(by_alias=True)).digest == first.digest


def test_a_suite_without_axes_of_packages_says_nothing_of_packages(gain):  # noqa: ARG001
    settings = load_suite("hurdles").model_dump(by_alias=True)
    assert "plugins" not in settings
    assert load_suite("hurdles").digest == new_suite(settings).digest


@pytest.mark.parametrize(
    ("perturb", "said"),
    [
        ("{gian: [0.5]}", ":9:11: unknown key 'gian'; did you mean 'gain'?"),
        ("{gain: [0.5, 9]}", ":9:23: perturb.gain.1: "),
        ("{gain: [0.5, 9]}", "must be at most 2"),
        ("{gain: [0.5, 0.5]}", ":9:11: perturb.gain: 0.5 is given twice; remove one"),
        ("{gain: [fast]}", ":9:18: perturb.gain.0: "),
        ("{frictoin: [1], gain: [7]}", ":9:11: unknown key 'frictoin'; did you mean 'friction'?"),
        ("{frictoin: [1], gain: [7]}", ":9:33: perturb.gain.0: "),
    ],
)
def test_what_is_wrong_with_it_is_told_with_its_place(suite, perturb, said):
    suite.write_text(SUITE.replace("{gain: [0.5, 1.0]}", perturb))
    with pytest.raises(SuiteError) as caught:
        load_suite(suite)
    assert said in str(caught.value)


def test_another_version_than_a_suite_pins_is_refused_at_its_line(suite):
    suite.write_text(SUITE + "plugins: {axes.gain: gainer 2.0}\n")
    with pytest.raises(SuiteError) as caught:
        api.plan(str(suite))
    assert str(caught.value).startswith(
        f"{suite}:10:11: plugins.axes.gain: it is to be gainer 2.0, and is gainer 1.0 here; "
        "pip install 'gainer==2.0'"
    )


def test_the_json_schema_and_sweeps_know_it(gain):  # noqa: ARG001
    offered = json_schema()["$defs"]["Perturb"]["properties"]
    assert set(offered) == {*BUILT_IN, "gain"}
    assert SweptAxis.of("gain=0.5..1.5:3").values == (0.5, 1.0, 1.5)
    with pytest.raises(UsageError, match=r"must be at most 2; give 0.1 to 2"):
        SweptAxis.of("gain=0.5..9")
    with pytest.raises(UsageError, match="did you mean 'gain'"):
        SweptAxis.of("gian=0.5..9")


def test_a_run_meets_it_and_says_whose_it_is_and_is_judged_where_it_is_not_installed(
    suite, tmp_path, gain
):
    code, said = command("run", str(suite), "--out", str(tmp_path / "run"), "--in-process")
    assert code == 0, said
    info = read_run_info(tmp_path / "run" / "run.json")
    assert info.plugins == {"axes.gain": identity_of(AXES, "gain")}
    assert info.engine["axes.gain"] == info.plugins["axes.gain"][: len("gainer 1.0 ") + 16]
    rows = nw_eval.read_rows(tmp_path / "run")
    assert len(set(rows["action_digest"])) <= 2
    assert len(set(rows["state_digest"])) == 2
    gain.unlink()
    (gain.parent / "gainer.dist-info" / "entry_points.txt").unlink()
    nw_base.plugins.installed.cache_clear()
    assert api.judge(tmp_path / "run").verdict.verdict == "RAN"
    code, said = command("run", "--resume", str(tmp_path / "run"), "--in-process")
    assert code == 2
    assert "plugins.axes.gain: it is to be gainer 1.0, and is not installed" in said


def test_code_that_changes_under_one_version_is_another_engine(suite, gain):
    from nw_eval.engine.provenance import journal_header

    before = journal_header(api.plan(str(suite))).engine
    gain.write_text(GAIN + "\n# changed\n")
    after = journal_header(api.plan(str(suite))).engine
    assert {key for key in before if before[key] != after[key]} == {"axes.gain"}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("raise KeyError(value)", "axis plug-in 'gain' of gainer (gainer:AXIS) raised KeyError at"),
        ("return None", "axis plug-in 'gain' of gainer (gainer:AXIS) returned a NoneType at 0.5"),
    ],
)
def test_an_axis_that_fails_is_told_before_anything_runs(suite, package, change, said):
    text = GAIN.replace("return setup.with_strength(value)", change)
    package("gainer", AXES, {"gain": "gainer:AXIS"}, text)
    with pytest.raises(PluginError) as caught:
        api.plan(str(suite))
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("points", "text", "said"),
    [
        ({"gain": "gainer:NOTHING"}, GAIN, "cannot be imported: AttributeError"),
        ({"gain": "no_such_module:AXIS"}, GAIN, "cannot be imported: ModuleNotFoundError"),
        ({"gain": "gainer:change"}, GAIN, "is a function, no nw_eval.Axis"),
        ({"gain": "gainer:AXIS"}, GAIN.replace('"gain"', '"grip"'), "is the Axis 'grip'"),
        ({"gain": "gainer:AXIS"}, GAIN.replace("high=2.0", "high=1.2"), "do not fit"),
    ],
)
def test_a_broken_package_is_named_where_its_axis_is(suite, package, points, text, said):
    package("gainer", AXES, points, text)
    with pytest.raises(SuiteError) as caught:
        load_suite(suite)
    assert f"{suite}:9:11: perturb.gain: plug-in 'gain' of gainer" in str(caught.value)
    assert said in str(caught.value)


def test_a_name_that_two_packages_claim_is_an_error_that_names_both(suite, package):
    package("rival", AXES, {"gain": "rival:AXIS"}, GAIN)
    with pytest.raises(SuiteError) as caught:
        load_suite(suite)
    assert "'gain' is claimed by two packages: plug-in 'gain' of gainer" in str(caught.value)
    assert "plug-in 'gain' of rival (rival:AXIS); uninstall one of them" in str(caught.value)


def test_a_built_in_name_stays_the_built_in_one(package):
    package("usurper", AXES, {"friction": "usurper:AXIS"}, "raise RuntimeError")
    with pytest.warns(PluginWarning, match="of usurper .* is ignored: 'friction' is built in"):
        suite = new_suite({**load_suite("hurdles").model_dump(by_alias=True),
                           "perturb": {"friction": [0.5]}})  # fmt: skip
    assert suite.plugins == {}
    package("usurper", SPLAT_FORMATS, {"ply": "usurper:FORMAT"})
    with pytest.warns(PluginWarning, match="'ply' is built in"):
        assert nw_splat.files.package_format(nw_splat.files.Path("a.ply")) is None


@pytest.mark.parametrize(
    ("figures", "said"),
    [
        ({"name": "a-b"}, "a name has letters, digits and '_' only"),
        ({"neutral": None}, "neither `neutral` nor `nominal`"),
        ({"neutral": 3.0}, "do not fit"),
        ({"slider": (0.0, 2.0, 0.0)}, "do not fit"),
    ],
)
def test_an_axis_whose_figures_do_not_fit_cannot_be_made(figures, said):
    fine = {"name": "a", "description": "", "neutral": 1.0, "low": 0.0, "high": 2.0}
    assert Axis(**fine, change=lambda setup, _: setup).slides == (0.0, 2.0, 0.02)
    with pytest.raises(ValueError, match=said):
        Axis(**{**fine, **figures}, change=lambda setup, _: setup)


def test_a_file_of_a_packages_format_is_a_scenes_splat_and_its_version_counts(tmp_path, package):
    module = package("points", SPLAT_FORMATS, {"pts": "points:FORMAT"}, POINTS)
    (tmp_path / "a.pts").write_text("12345")
    assert len(read_splat(tmp_path / "a.pts")) == 5
    (tmp_path / "collision.yaml").write_text(
        "boxes: [{center: [2, 0, 0.1], half_size: [0.1, 0.5, 0.1]}]\n"
    )
    (tmp_path / "scene.yaml").write_text(
        "{nw-scene: 1, name: p, task: hurdles, licence: MIT, trail: [[2.5, 0, 0]], splat: a.pts}"
    )
    first = load_folder(tmp_path).digest
    assert load_folder(tmp_path).digest == first
    package("points", SPLAT_FORMATS, {"pts": "points:FORMAT"}, version="1.1")
    second = load_folder(tmp_path).digest
    module.write_text(POINTS + "\n# changed\n")
    assert len({first, second, load_folder(tmp_path).digest}) == 3
    with pytest.raises(UsageError, match=r"cannot write .\.pts"):
        write_splat(tmp_path / "b.pts", read_splat(tmp_path / "a.pts"))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("n = path", "raise KeyError(1)\n    n = path", "'pts' of points .* cannot read it: KeyEr"),
        ("return Gaussians(", "return dict(", "read a dict, no Gaussians, from"),
        ("read=read)", "read=read, sniff=lambda path, mark: False)", "which plug-in 'pts' of poin"),
    ],
)
def test_a_reader_that_fails_is_named_with_the_file(tmp_path, package, old, new, said):
    package("points", SPLAT_FORMATS, {"pts": "points:FORMAT"}, POINTS.replace(old, new))
    (tmp_path / "a.pts").write_text("1")
    with pytest.raises((SceneError, PluginError), match=said):
        read_splat(tmp_path / "a.pts")


REPORTER = """
import sys
from nw_eval import Reporter, PrerequisiteError

def report(run, path):
    {body}

REPORTER = Reporter(name="slip", writes="slip of paper", report=report, {more})
"""


@pytest.fixture(scope="module")
def judged(tmp_path_factory):
    folder = tmp_path_factory.mktemp("judged")
    api.run("smoke", policy="stand", trials=1, scenes=("hurdles/three_low",), record="none",
            out=folder / "run", in_process=True)  # fmt: skip
    return folder / "run"


def reported(package, judged, option, body, more='target="file"'):
    text = REPORTER.format(body=body, more=more)
    package("slips", REPORTERS, {"slip": "slips:REPORTER"}, text)
    return command("report", str(judged), "--reporter", option, "--no-pictures")


@pytest.mark.parametrize(
    "body",
    [
        pytest.param("raise KeyError(path)", marks=pytest.mark.nightly),
        "path.write_text('half'); raise OSError(28, 'No space')",
        pytest.param("sys.exit(7)", marks=pytest.mark.nightly),
    ],
)
def test_a_reporter_that_fails_costs_no_verdict_and_leaves_what_was_there(
    package, judged, tmp_path, body
):
    (tmp_path / "slip").write_text("of yesterday")
    code, said = reported(package, judged, f"slip={tmp_path / 'slip'}", body)
    assert code == 0
    assert "warning: no slip of paper: " in said
    assert "RAN" in said
    assert (tmp_path / "slip").read_text() == "of yesterday"


def test_a_reporter_gets_the_judged_run_and_its_words(package, judged, tmp_path):
    body = f"open({str(tmp_path / 'said')!r}, 'w').write(f'{{run.verdict.verdict}} {{path}}')"
    code, said = reported(package, judged, "slip=#robots", body, 'target="words"')
    assert (code, (tmp_path / "said").read_text()) == (0, "RAN #robots"), said
    code, said = reported(package, judged, "slip", body, 'target="words"')
    assert (tmp_path / "said").read_text() == "RAN None"


@pytest.mark.parametrize(
    ("option", "more", "said"),
    [
        ("slip", 'target="file"', "--reporter slip: it writes a file; --reporter slip=PATH"),
        ("slip=a", "", "--reporter slip=a: it takes nothing; --reporter slip"),
        ("slpi", "", "--reporter slpi is unknown; did you mean 'slip'?"),
        ("slip", "nonsense=1", "cannot be imported: TypeError"),
        ("junit", "", "--reporter junit: it writes a file"),
    ],
)
def test_a_reporter_that_cannot_be_used_is_told_before_anything_runs(
    package, judged, option, more, said
):
    code, words = reported(package, judged, option, "pass", more)
    assert code == 2
    assert said in words


def test_a_run_without_a_verdict_removes_what_a_reporter_wrote_before(package, tmp_path):
    text = REPORTER.format(body="path.write_text('x')", more='target="file"')
    package("slips", REPORTERS, {"slip": "slips:REPORTER"}, text)
    (tmp_path / "slip").write_text("of yesterday")
    code, _ = command("report", str(tmp_path / "none"), "--reporter", f"slip={tmp_path / 'slip'}")
    assert code != 0
    assert not (tmp_path / "slip").exists()


def test_junit_is_a_reporter_like_any_other(judged, tmp_path):
    for words in (["--junit", str(tmp_path / "a")], ["--reporter", f"junit={tmp_path / 'b'}"]):
        assert command("report", str(judged), "--no-pictures", *words)[0] == 0
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_the_version_of_a_sensors_package_is_part_of_its_policy(tmp_path, package):
    text = "import numpy as np\nclass Beam:\n    shape, dtype = (1,), np.float32\n"
    module = package("beams", SENSORS, {"beam": "beams:Beam"}, text)
    (tmp_path / "policy.yaml").write_text(
        "nw-policy: 1\nname: b\nrobot: go1\nadapter: zero\n"
        "control: {action: joint_position_offset}\nobservations: {o: {sensor: beam}}\n"
    )
    known_or_raise("beam", SENSORS, ())
    first = load_bundle(tmp_path)
    assert first.plugins == {"sensors.beam": identity_of(SENSORS, "beam")}
    digests = {(first.digest, first.computes)}
    package("beams", SENSORS, {"beam": "beams:Beam"}, version="1.1")
    digests.add((load_bundle(tmp_path).digest, load_bundle(tmp_path).computes))
    module.write_text(text + "# changed\n")
    digests.add((load_bundle(tmp_path).digest, load_bundle(tmp_path).computes))
    assert [len(set(each)) for each in zip(*digests, strict=True)] == [3, 3]
