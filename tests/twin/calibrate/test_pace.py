"""Lines of progress come now and then, with what is left."""

from nw_eval.twin.calibrate.pace import Pace


def test_a_line_comes_every_ten_seconds_and_at_the_end():
    now, lines = [0.0], []
    pace = Pace(lines.append, "pictures", 100, clock=lambda: now[0])
    for done in range(1, 101):
        now[0] += 4.0
        pace.at(done)
    assert lines[0] == "pictures: 3 of 100, about 6 min left"
    assert lines[-2] == "pictures: 99 of 100, about 4 s left"
    assert lines[-1] == "pictures: 100 in 7 min"
    assert len(lines) == 34
