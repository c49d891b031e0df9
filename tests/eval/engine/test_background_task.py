"""What a process does while others run its trials: once it has hired them, and to the end."""

import threading
from dataclasses import dataclass, field

import pytest

from nw_base.errors import StoreError
from nw_eval.engine.session import BackgroundTask


@dataclass
class Hires:
    """Gets workers that are words, and remembers what was begun by then."""

    begun: list[str]
    seen: list[tuple[str, ...]] = field(default_factory=list)
    again: str = "elsewhere"

    def __call__(self, count, *, fresh):
        self.seen.append(tuple(self.begun))
        return f"{count} {'fresh' if fresh else 'used'}"


def test_the_work_begins_once_and_after_the_first_workers_are_hired():
    begun, hires = [], Hires([])
    hires.begun = begun
    with BackgroundTask(
        hires, lambda: begun.append(threading.current_thread().name)
    ) as start_workers:
        assert not begun
        assert start_workers(2, fresh=False) == "2 used"
        assert start_workers(1, fresh=True) == "1 fresh"
        assert start_workers.again == "elsewhere"
    assert hires.seen[0] == ()
    assert len(begun) == 1
    assert begun != [threading.current_thread().name]


def test_the_work_is_done_where_there_was_nothing_to_hire_workers_for():
    begun = []
    with BackgroundTask(Hires(begun), lambda: begun.append("")):
        pass
    assert begun == [""]


def test_the_end_waits_for_the_work_and_raises_what_it_raised():
    ends, goes_on = [], threading.Event()

    def fail():
        goes_on.wait()
        ends.append("")
        raise StoreError("disk full")

    def run():
        with BackgroundTask(Hires([]), fail) as start_workers:
            start_workers(1, fresh=False)
            goes_on.set()

    with pytest.raises(StoreError, match="disk full"):
        run()
    assert ends == [""]


def test_a_run_that_fails_says_why_whatever_becomes_of_the_work():
    begun = []

    def fail():
        raise StoreError("disk full")

    def run(work):
        with BackgroundTask(Hires(begun), work) as start_workers:
            if work is fail:
                start_workers(1, fresh=False)
            raise KeyboardInterrupt

    for work in (fail, lambda: begun.append("")):
        with pytest.raises(KeyboardInterrupt):
            run(work)
    assert not begun, "what was not begun is not begun any more"
