"""A built-in course, photographed, built again from the photographs alone, compared."""

import pytest
from closed_loop import build, compare, photograph
from walk import round_the_first_obstacle


@pytest.mark.nightly
def test_a_bar_built_from_twenty_small_photographs_is_walked_over_like_the_bar(tmp_path):
    name = "hurdles/one_low_carpet"
    size = {"count": 20, "width": 480, "height": 270}
    cameras = photograph(name, tmp_path / "photographs", walk=round_the_first_obstacle, **size)
    quick = ("--iterations", "120", "--longest", "240", "--gaussians", "20000", "--workers", "1")
    build(tmp_path / "photographs", tmp_path / "twin", quick)
    teacher = ("go1-parkour",)
    found = compare(name, cameras, tmp_path / "twin", tmp_path, trials=3, policies=teacher)
    assert found.frame.registered >= 0.8
    assert found.frame.gravity < 0.5
    assert abs(found.frame.scale) < 0.015
    assert found.surface.accuracy < 0.008
    assert found.surface.f > 0.9
    assert found.looks.splat > found.looks.mesh
    reached = {place: outcome.success for place, outcome in found.trials["go1-parkour"].items()}
    assert reached["original"] == 1.0
    assert reached["carried"] >= 0.8


@pytest.mark.nightly
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    "name",
    [
        "hurdles/one_low_carpet",
        "gaps/two_12in_carpet",
        "ramps/one_ramp_plaza",
        "stairs/five_low_podium",
    ],
)
def test_a_course_built_from_forty_photographs_is_walked_like_the_course(tmp_path, name):
    cameras = photograph(name, tmp_path / "photographs")
    quick = ("--iterations", "700", "--longest", "320", "--gaussians", "60000")
    build(tmp_path / "photographs", tmp_path / "twin", quick)
    teacher = ("go1-parkour",)
    found = compare(name, cameras, tmp_path / "twin", tmp_path, trials=100, policies=teacher)
    assert found.frame.registered >= 0.9
    assert found.frame.gravity < 0.3
    assert abs(found.frame.scale) < 0.01
    assert found.surface.accuracy < 0.008
    assert found.surface.f > 0.9
    assert found.looks.splat >= found.looks.mesh + 4.0, "dB, at a robot's height"
    places = found.trials["go1-parkour"]
    assert places["carried"].success == pytest.approx(places["original"].success, abs=0.05)
    assert places["own trail"].success >= 0.9
    assert (tmp_path / "sheet.jpg").stat().st_size < 300_000
