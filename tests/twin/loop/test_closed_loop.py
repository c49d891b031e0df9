"""By night: a built-in course, photographed, built again from the photographs alone, compared."""

import pytest
from closed_loop import build, compare, photograph


@pytest.mark.nightly
def test_a_course_built_from_forty_photographs_is_the_course(tmp_path):
    name = "hurdles/one_low_carpet"
    cameras = photograph(name, tmp_path / "photographs")
    quick = ("--iterations", "700", "--longest", "320", "--gaussians", "60000")
    build(tmp_path / "photographs", tmp_path / "twin", quick)
    found = compare(name, cameras, tmp_path / "twin", tmp_path, trials=0)
    assert found.frame.registered >= 0.9
    assert found.frame.gravity < 0.3
    assert abs(found.frame.scale) < 0.01
    assert found.surface.accuracy < 0.008
    assert found.surface.f > 0.9
    assert found.looks.splat > found.looks.mesh
    assert (tmp_path / "sheet.jpg").stat().st_size < 300_000
