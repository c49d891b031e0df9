"""Lines of progress come now and then, with what is left."""

from nw_twin.calibrate.report import Pace


def test_a_line_comes_every_five_seconds_and_at_the_end():
    now, lines = [0.0], []
    pace = Pace(lines.append, "pictures", 100, clock=lambda: now[0])
    for done in range(1, 101):
        now[0] += 2.0
        pace.at(done)
    assert lines[0] == "pictures: 3 of 100, about 3 min left"
    assert lines[-2] == "pictures: 99 of 100, about 2 s left"
    assert lines[-1] == "pictures: 100 in 3 min"
    assert len(lines) == 34


def test_what_was_done_before_does_not_count_towards_the_pace():
    now, lines = [0.0], []
    pace = Pace(lines.append, "pairs", 100, clock=lambda: now[0], begun_at=90)
    for done in range(91, 101):
        now[0] += 6.0
        pace.at(done)
    assert lines[0] == "pairs: 91 of 100, about 54 s left"


def test_work_without_pieces_says_how_long_it_goes_on():
    now, lines = [0.0], []
    pace = Pace(lines.append, "mapping", 0, clock=lambda: now[0])
    for _ in range(12):
        now[0] += 1.0
        pace.goes_on()
    assert lines == ["mapping: 5 s so far", "mapping: 10 s so far"]
