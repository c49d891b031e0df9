"""Which files pytest takes for suites, what their tests are called, and what a wrong one says."""

import subprocess
import sys

import pytest

FLAT, HURDLE = "flat/carpet_room", "hurdles/one_low_carpet"


def ids(done):
    """Return the ids of the tests that a session has found."""
    return [line for line in done.outlines if "::" in line and not line.startswith("ERROR")]


def test_a_suite_that_is_named_has_a_test_for_each_scene_and_one_for_the_verdict(
    suite, run, pytester
):
    suite("suites/tiny.yaml", scenes=["hurdles/one_low_*", FLAT, HURDLE])
    done = run("--collect-only", "-q", "suites/tiny.yaml")
    assert ids(done) == [
        "suites/tiny.yaml::hurdles/one_low_carpet",
        "suites/tiny.yaml::flat/carpet_room",
        "suites/tiny.yaml::verdict",
    ]
    assert not (pytester.path / "reports").exists(), "nothing has run"
    done = run("--collect-only", "-q", f"suites/tiny.yaml::{HURDLE}")
    assert ids(done) == [f"suites/tiny.yaml::{HURDLE}"]


def test_only_what_says_that_it_is_a_suite_is_found_in_a_folder(suite, run, pytester):
    suite("deep/one.nw.yaml")
    suite("plain.yaml")
    suite("suites/two.yaml")
    suite("suites/three.yml")
    (pytester.path / "compose.yaml").write_text("services: {web: {}}\n")
    found = "deep/one.nw.yaml"
    assert {each.partition("::")[0] for each in ids(run("--collect-only", "-q"))} == {found}
    for declared in ("suites", "suites/*.y*ml"):
        done = run("--collect-only", "-q", "-o", f"nw_suites={declared}")
        files = {each.partition("::")[0] for each in ids(done)}
        assert files == {found, "suites/two.yaml", "suites/three.yml"}


@pytest.mark.parametrize(
    "text", ["services: {web: {}}\n", "a: {nw-eval: 1}\n", "# nw-eval: 1\n", "\x00", ""]
)
def test_a_yaml_file_that_is_no_suite_is_left_alone_though_it_is_named(run, pytester, text):
    (pytester.path / "compose.yaml").write_text(text)
    done = run("compose.yaml")
    assert done.ret == pytest.ExitCode.USAGE_ERROR
    done.stderr.fnmatch_lines(["ERROR: not found: *compose.yaml"])


@pytest.mark.parametrize(
    ("name", "change", "sentence"),
    [
        ("a.yaml", ("trials: 1", "trials: 0"), "a.yaml:5:1: trials*"),
        ("a.yaml", ("flat/carpet_room", '"\\e[31mflat"'), "a.yaml:8:10: no scene matches *"),
        ("a.yaml", ("robot", '"\\e[31m\\u202e"'), r"a.yaml:3:1: *\x1b[[]31m\u202e*"),
        ("a.yaml", ("robot: go1", "robot: [go1"), "a.yaml:*: is not YAML*"),
        ("a.nw.yaml", ("nw-eval: 1\n", ""), "a.nw.yaml:1:1: *nw-eval*"),
    ],
)
def test_a_wrong_suite_is_a_collection_error_that_says_where_and_what(
    suite, run, name, change, sentence
):
    path = suite(name)
    path.write_text(path.read_text().replace(*change))
    done = run(name)
    assert done.ret == pytest.ExitCode.INTERRUPTED
    done.assert_outcomes(errors=1)
    done.stdout.fnmatch_lines([f"*_ ERROR collecting {name} _*", sentence])
    whole = done.stdout.str()
    assert "Traceback" not in whole
    assert "\x1b" not in whole
    assert "\u202e" not in whole


def test_all_that_is_wrong_with_a_suite_is_said_at_once(suite, run):
    suite(scenes=["flatt/room", "hurdles/one_lw"], trials=0)
    done = run("tiny.yaml")
    done.stdout.fnmatch_lines(["tiny.yaml:5:1: *", "tiny.yaml:8:10: *", "tiny.yaml:8:22: *"])


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--nw-rounds", "0"], "ERROR: --nw-rounds 0: give a whole number, at least 1"),
        (["--nw-workers", "many"], "ERROR: --nw-workers many: give a whole number, at least 1"),
        (["-o", "nw_rounds=x"], "ERROR: --nw-rounds x: give a whole number, at least 1"),
        (["-o", "nw_inconclusive=skip"], "ERROR: nw_inconclusive = skip: give one of fail, *"),
        (["-o", "nw_suites=/etc"], "ERROR: nw_suites = /etc: give a path below *"),
    ],
)
def test_an_option_that_cannot_be_used_ends_the_session_with_a_line(run, arguments, sentence):
    done = run(*arguments)
    assert done.ret == pytest.ExitCode.USAGE_ERROR
    done.stderr.fnmatch_lines([sentence])
    assert "Traceback" not in done.stderr.str()


def test_markers_are_registered_and_tell_suites_from_other_tests(suite, run, pytester):
    suite()
    pytester.makepyfile("def test_other(): pass")
    found = ids(run("--collect-only", "-q", "--strict-markers", "-m", "nw", "tiny.yaml", "."))
    assert found == [f"tiny.yaml::{FLAT}", "tiny.yaml::verdict"]
    run("--strict-markers", "-m", "not nw", "tiny.yaml", ".").assert_outcomes(
        passed=1, deselected=2
    )


def test_a_session_without_suites_hears_nothing_and_imports_nothing_heavy(pytester):
    pytester.makepyfile("""
        import sys

        def test_what_is_imported():
            heavy = {"numpy", "pydantic", "mujoco", "torch", "rich", "ruamel", "junitparser"}
            assert not heavy & {*sys.modules}
            assert {name for name in sys.modules if name.startswith("nw_eval")} == {
                "nw_eval",
                "nw_eval.pytest_plugin",
                "nw_eval.pytest_plugin.options",
                "nw_eval.pytest_plugin.options",
            }
    """)
    (pytester.path / "compose.yaml").write_text("services: {web: {}}\n")
    line = [sys.executable, "-m", "pytest", "-q", "-p", "nw_eval.pytest_plugin"]
    done = subprocess.run(
        line,
        cwd=pytester.path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    dots, _, end = done.stdout.partition("\n")
    assert dots.split() == [".", "[100%]"]
    assert end.startswith("1 passed in ")
    assert end.count("\n") == 1, "not a line of the plugin's"
