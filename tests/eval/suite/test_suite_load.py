from __future__ import annotations

import textwrap
import time
from typing import TYPE_CHECKING

import pytest

from nw_base.errors import SuiteError, UsageError
from nw_eval.suite import find_suite, load_suite

if TYPE_CHECKING:
    from pathlib import Path

GOOD = """\
    nw-eval: 1
    name: hurdles
    robot: go1
    policy: go1-parkour
    trials: 10
    seed: 20261
    scenes: [hurdles/*]
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "suite.yaml"
    path.write_text(textwrap.dedent(text), encoding="utf-8")
    return path


def problems(folder: Path, text: str) -> list[str]:
    """Problems as `line:column: message`, without the file."""
    path = write(folder, text)
    with pytest.raises(SuiteError) as caught:
        load_suite(path)
    assert all(problem.file == str(path) for problem in caught.value.problems)
    return [str(problem).removeprefix(f"{path}:") for problem in caught.value.problems]


def test_a_file_with_every_setting_becomes_those_settings(tmp_path: Path) -> None:
    text = """\
        protocol: neverwhere-2026
        episode: {duration: 8}
        perturb: {friction: [0.6, 1]}
        record: all
        gate:
          success_rate: 0.75
          max_drop: 0.2
          confidence: 0.9
          tiers: {hurdles/three_low: critical}
    """
    suite = load_suite(write(tmp_path, textwrap.dedent(GOOD) + textwrap.dedent(text)))
    assert (suite.name, suite.robot, suite.policy) == ("hurdles", "go1", "go1-parkour")
    assert (suite.trials, suite.seed, suite.protocol) == (10, 20261, "neverwhere-2026")
    assert suite.episode.duration == 8.0
    assert suite.perturb.cells == ((("friction", 0.6),), (("friction", 1.0),))
    assert suite.record == "all"
    assert (suite.gate.success_rate, suite.gate.max_drop, suite.gate.confidence) == (0.75, 0.2, 0.9)
    assert suite.gate.tier("hurdles/three_low") == "critical"
    assert suite.base == tmp_path


def test_what_a_file_leaves_out_has_the_documented_default(tmp_path: Path) -> None:
    suite = load_suite(write(tmp_path, GOOD))
    assert suite.protocol == "strict"
    assert suite.episode.duration == 12.0
    assert suite.perturb.cells == ((),)
    assert suite.record == "failures"
    assert suite.gate.success_rate is None
    assert suite.gate.tier("hurdles/any") == "supporting"


def test_every_problem_of_a_file_is_told_at_once_in_file_order(tmp_path: Path) -> None:
    found = problems(
        tmp_path,
        """\
        nw-eval: 2
        nam: hurdles
        robot: [go1]
        policy: go1-parkour
        trials: 0
        seed: 1.5
        episode: {duration: "12", durations: 4}
        scenes: [hurdles/*, hurdles/*]
        perturb: {frictoin: [1.0]}
        record: fail
        gate:
          success_rate: 75
          tiers: {hurdles/three_low: crit}
        """,
    )
    lines = [int(problem.partition(":")[0]) for problem in found]
    assert lines == [1, 1, 2, 3, 5, 6, 7, 7, 8, 9, 10, 12, 13]
    told = "\n".join(found)
    for words in (
        "'name' is missing",
        "unknown key 'nam'; did you mean 'name'?",
        "robot: should be text",
        "trials: must be at least 1, got 0",
        "got 1.5",
        "got '12'",
        "unknown key 'durations'; did you mean 'duration'?",
        "'hurdles/*' is given twice",
        "unknown key 'frictoin'; did you mean 'friction'?",
        "'fail' is not one of them; did you mean 'failures'?",
        "got 75",
        "'crit' is not one of them; did you mean 'critical'?",
    ):
        assert words in told


def test_a_duplicate_key_and_a_tag_hide_no_other_problem(tmp_path: Path) -> None:
    found = problems(
        tmp_path,
        GOOD
        + """\
    trials: 5
    record: !!binary aGVsbG8=
    protocol: stric
    gate: {confidence: 95}
    """,
    )
    assert [problem.split(": ")[0] for problem in found] == ["8:1", "9:9", "10:1", "11:8"]


@pytest.mark.parametrize(
    ("line", "place", "words"),
    [
        ("trials: 0", "5:1", "got 0"),
        ("trials: ten", "5:1", "should be a whole number, got 'ten'"),
        ("trials: true", "5:1", "got True"),
        ("trials: 2.0", "5:1", "got 2.0"),
        ("trials:", "5:1", "got None"),
        ("seed: -1", "6:1", "got -1"),
        ("scenes: []", "7:1", "is empty; name at least one"),
        ("scenes: hurdles/*", "7:1", "should be a list, such as [a, b], got 'hurdles/*'"),
        ("scenes: ['']", "7:10", "at least 1 character"),
        ("scenes: [3]", "7:10", "got 3"),
        ("name: a b", "2:1", "got 'a b'"),
        ("name: ../x", "2:1", "got '../x'"),
        ("gate: {confidence: 95}", "8:8", "got 95"),
        ("gate: {success_rate: 1.0}", "8:8", "must be at most"),
        ("gate: {success_rate: .nan}", "8:8", "finite"),
        ("gate: 0.9", "8:1", "should be a mapping, got 0.9"),
        ("episode: {duration: 0}", "8:11", "must be more than 0"),
        ("perturb: {friction: [0.5, -1]}", "8:27", "got -1"),
        ("perturb: {friction: 0.5}", "8:11", "got 0.5"),
        ("protocol: stric", "8:1", "did you mean 'strict'?"),
        ("render: {projection: rays}", "8:10", "did you mean 'ray'?"),
        ("render: {samples: 2}", "8:10", "known: 1, 4"),
        ("render: {near: 0}", "8:10", "must be more than 0"),
    ],
)
def test_a_bad_value_is_told_with_its_place(
    tmp_path: Path, line: str, place: str, words: str
) -> None:
    key = line.split(":", maxsplit=1)[0]
    lines = textwrap.dedent(GOOD).splitlines()
    kept = [line if one.startswith(f"{key}:") else one for one in lines]
    text = "\n".join(kept if line in kept else [*lines, line])
    (problem,) = problems(tmp_path, text)
    assert problem.startswith(f"{place}: ")
    assert words in problem


def test_the_published_protocol_takes_the_published_pictures_only(tmp_path: Path) -> None:
    text = GOOD + "    protocol: neverwhere-2026\n    render: {projection: ray}\n"
    (problem,) = problems(tmp_path, text)
    assert problem.startswith("9:1: ")
    assert "neverwhere-2026 draws with ewa" in problem
    assert "set protocol: strict" in problem


def test_a_duplicate_key_is_told_with_both_lines(tmp_path: Path) -> None:
    assert problems(tmp_path, GOOD + "    trials: 5\n") == [
        "8:1: duplicate key 'trials', first on line 5; keep one of them"
    ]


def test_a_tag_is_refused_and_runs_nothing(tmp_path: Path) -> None:
    marker = tmp_path / "ran"
    (problem,) = problems(
        tmp_path, GOOD + f"    record: !!python/object/apply:os.system ['touch {marker}']\n"
    )
    assert problem.startswith("8:9: ")
    assert "tag" in problem
    assert not marker.exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "empty"),
        ("# only a comment\n", "empty"),
        ("- a\n- b\n", "not a mapping"),
        ("just text", "not a mapping"),
        ("a: [1, 2", "not YAML"),
        ("a: 1\n  b: 2\n", "not YAML"),
        ("a: 1\n---\nb: 2\n", "not YAML"),
        ("\tname: x\n", "not YAML"),
    ],
)
def test_a_file_that_is_no_suite_at_all_says_so(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "suite.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SuiteError, match=words):
        load_suite(path)


def test_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "suite.yaml"
    path.write_bytes(b"nw-eval: 1\nname: \xff\xfe\n")
    with pytest.raises(SuiteError, match="UTF-8"):
        load_suite(path)


def test_bombs_are_refused_quickly(tmp_path: Path) -> None:
    aliases = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
        f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]\n" for k in range(1, 12)
    )
    for text in (aliases, "a: &a [*a]\n", "a: " + "[" * 20_000, "# " + "x" * 2_000_000):
        path = tmp_path / "suite.yaml"
        path.write_text(text, encoding="utf-8")
        start = time.thread_time()  # Whatever else the machine does.
        with pytest.raises(SuiteError):
            load_suite(path)
        assert time.thread_time() - start < 20.0


def test_a_perturbation_grid_is_bounded(tmp_path: Path) -> None:
    values = ", ".join(f"{0.5 + index / 100_000}" for index in range(10_001))
    with pytest.raises(SuiteError, match="10001 cells"):
        load_suite(write(tmp_path, textwrap.dedent(GOOD) + f"perturb: {{friction: [{values}]}}\n"))


def test_a_missing_suite_names_the_nearest_one() -> None:
    with pytest.raises(UsageError, match="no suite 'hurdels'; did you mean 'hurdles'"):
        load_suite("hurdels")
    with pytest.raises(UsageError, match=r"suites/hurdels.yaml.*did you mean 'hurdles'"):
        load_suite("suites/hurdels.yaml")


def test_a_folder_is_no_suite(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="is a folder"):
        load_suite(tmp_path)


def test_a_projects_own_suite_hides_the_shipped_one(tmp_path: Path) -> None:
    own = tmp_path / "suites" / "hurdles.yaml"
    own.parent.mkdir()
    own.write_text(textwrap.dedent(GOOD), encoding="utf-8")
    assert find_suite("hurdles", tmp_path) == own
    assert find_suite("smoke", tmp_path).name == "smoke.yaml"  # Shipped, no own one.
    assert find_suite("suites/hurdles.yaml", tmp_path) == own


def test_too_many_open_brackets_are_told_with_their_place_and_quoted_ones_are_none(
    tmp_path: Path,
) -> None:
    path = tmp_path / "suite.yaml"
    path.write_text("name: x\nscenes: " + "[" * 201 + "\n", encoding="utf-8")
    with pytest.raises(SuiteError, match=r"suite\.yaml:2:209: over 200 brackets are open here"):
        load_suite(path)
    many = "[{" * 300
    path.write_text(f"# {many}\nname: '{many}'\nrobot: \"{many}\"\n", encoding="utf-8")
    with pytest.raises(SuiteError) as caught:
        load_suite(path)
    assert "are open here" not in str(caught.value)
