"""A comparison reads as it is: on the terminal, as Markdown, and as a picture."""

from dataclasses import replace

import pytest
from matplotlib import colormaps
from PIL import Image

from nw_eval.cli.verbs.compare import comparison_text
from nw_eval.reporting.pictures import draw_comparison
from nw_eval.reporting.side_by_side import comparison_page
from nw_gate.side_by_side import (
    ComparedPolicy,
    ComparedScene,
    ComparedTask,
    PolicyComparison,
    SceneParting,
)
from nw_gate.stats.hazard import differences
from nw_gate.stats.interval import Estimate, Interval
from nw_gate.stats.ranks import Ranks


def policy(label, mean, best, worst):
    return ComparedPolicy(
        label=label,
        policy=label,
        source=f"reports/{label}",
        mean=mean,
        interval=Interval(mean - 0.1, min(1.0, mean + 0.1)),
        completed=round(20 * mean),
        ranks=Ranks(best=best, worst=worst),
    )


def task(name, *means):
    estimates = (
        Estimate(mean=mean, interval=Interval(mean - 0.1, mean + 0.1), n=10, confidence=0.95)
        for mean in means
    )
    return ComparedTask(task=name, scenes=1, estimates=tuple(estimates))


@pytest.fixture
def found():
    _, at = differences([0, 0, 10], [0, 10, 0])
    _, weak = differences([0, 0, 10], [0, 5, 5])
    return PolicyComparison(
        suite="hurdles",
        confidence=0.95,
        policies=(policy("old", 0.9, 1, 2), policy("new|er", 0.95, 1, 2), policy("x", 0.2, 3, 3)),
        scenes=(
            ComparedScene(scene="hurdles/a", starts=10, means=(0.8, 0.9, 0.4)),
            ComparedScene(scene="hurdles/b", starts=10, means=(1.0, 1.0, 0.0)),
        ),
        tasks=(task("hurdles", 0.8, 0.9, 0.4), task("gaps", 0.7, 0.6, 0.2)),
        partings=(
            SceneParting(scene="hurdles/b", policy=2, at=at, shown=True),
            SceneParting(scene=None, policy=1, at=weak, shown=False),
        ),
        waypoints=18,
        shared=True,
        left_out=3,
    )


def test_the_terminal_has_ranks_scenes_and_partings(found):
    lines = comparison_text(found).splitlines()
    rows = {line.split()[0]: line.split() for line in lines if line}
    # The best first; what is undecided is a range.
    assert [line.split()[0] for line in lines[3:6]] == ["new|er", "old", "x"]
    assert rows["old"][1:5] == ["1", "to", "2", "0.900"]
    assert rows["hurdles/b"] == ["hurdles/b", "10", "1.000", "1.000", "0.000"]
    assert "x       hurdles/b            2  0 of 10        10 of 10          yes" in lines
    assert "new|er  all together         2  0 of 10        5 of 10           suspect" in lines
    assert "3 initial states of some only left out" in " ".join(lines)


def test_success_by_task_stands_where_there_are_several(found):
    (gaps,) = [line for line in comparison_page(found).splitlines() if line.startswith("| gaps ")]
    assert [cell.strip() for cell in gaps.split("|")[1:-1]] == [
        "gaps", "1", "0.700 (0.60 to 0.80)", "0.600 (0.50 to 0.70)", "0.200 (0.10 to 0.30)",
    ]  # fmt: skip
    assert "Success by task" not in comparison_page(replace(found, tasks=found.tasks[:1]))


def test_a_page_of_markdown_escapes_what_would_break_its_tables(found):
    page = comparison_page(found)
    assert page.startswith("# Policies on hurdles\n")
    assert "## Success by scene\n" in page
    assert "## The first waypoint at which a policy parts from old\n" in page
    assert "new\\|er" in page
    assert "new|er" not in page.replace("new\\|er", "")


def test_the_picture_has_a_cell_for_each_scene_and_policy(found, tmp_path):
    draw_comparison(found, tmp_path / "seen.png")
    with Image.open(tmp_path / "seen.png") as picture:
        counts = picture.convert("RGB").getcolors(maxcolors=1 << 24)
    large = {colour for count, colour in counts if count > 9000}
    for mean in (0.8, 0.9, 0.4, 1.0, 0.0):
        assert tuple(map(int, colormaps["cividis"](mean, bytes=True)[:3])) in large
    assert not {(0, 0, 0), (255, 0, 0)} & large


def test_names_from_anywhere_are_no_formula_in_the_picture(found, tmp_path):
    scenes = (ComparedScene(scene="$\\frac{", starts=1, means=(0.1, 0.2, 0.3)),)
    broken = vars(found) | {"suite": "$x^{", "scenes": scenes, "partings": ()}
    draw_comparison(PolicyComparison(**broken), tmp_path / "seen.png")
    assert (tmp_path / "seen.png").stat().st_size > 1000


def test_a_table_of_many_policies_goes_on_beneath_within_120_columns(found):
    names = [f"a-policy-with-a-long-name-{k}" for k in range(9)]
    scenes = tuple(replace(scene, means=tuple(k / 10 for k in range(9))) for scene in found.scenes)
    policies = tuple(policy(name, 0.5, 1, 9) for name in names)
    many = replace(found, policies=policies, scenes=scenes, tasks=(), partings=())
    lines = comparison_text(many).splitlines()
    assert max(map(len, lines)) <= 120
    first = [line.split() for line in lines if line.startswith("hurdles/a")]
    assert len(first) == 3
    assert [cell for line in first for cell in line[1:]] == ["10", *(f"0.{k}00" for k in range(9))]
    assert all(any(name in line for line in lines) for name in names)
