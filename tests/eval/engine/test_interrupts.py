"""Signals to the process that runs a suite."""

import os
import signal
import socket
import threading

import pytest

from nw_base.confinement import child_environment, interrupts_blocked
from nw_eval.engine.machine import Interrupts


def test_the_first_signal_asks_and_the_second_ends():
    with Interrupts() as interrupts:
        assert interrupts.requested is None
        os.kill(os.getpid(), signal.SIGTERM)
        assert interrupts.requested is signal.SIGTERM
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
        assert interrupts.requested is signal.SIGTERM
        os.kill(os.getpid(), signal.SIGINT)  # The end is under way: a third changes nothing.


def test_handlers_are_put_back():
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    with Interrupts():
        assert signal.getsignal(signal.SIGINT) != before[0]
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before


def test_outside_the_main_thread_signals_are_left_alone():
    before = signal.getsignal(signal.SIGINT)
    seen = []

    def listen():
        with Interrupts() as interrupts:
            seen.append((signal.getsignal(signal.SIGINT), interrupts.requested))

    thread = threading.Thread(target=listen)
    thread.start()
    thread.join()
    assert seen == [(before, None)]


def test_a_process_started_deaf_does_not_hear_ctrl_c():
    with interrupts_blocked():
        assert signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_that_another_thread_lets_in_waits_until_the_child_is_started(number):
    started = threading.Event()
    thread = threading.Thread(target=started.wait)
    thread.start()
    steps = []
    arrived, theirs = socket.socketpair()
    arrived.settimeout(60.0)
    theirs.setblocking(False)
    before = signal.set_wakeup_fd(theirs.fileno())
    try:
        with Interrupts() as interrupts:
            with interrupts_blocked():
                os.kill(os.getpid(), number)
                assert arrived.recv(1) == bytes([number])  # Some thread was interrupted by it.
                steps.append(interrupts.requested)
            assert (steps, interrupts.requested) == ([None], number)
    finally:
        signal.set_wakeup_fd(before)
        started.set()
        thread.join()
        arrived.close()
        theirs.close()


def test_workers_get_one_thread_and_the_parent_keeps_its_own_setting(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
    with child_environment():
        assert (os.environ["OMP_NUM_THREADS"], os.environ["NUMBA_NUM_THREADS"]) == ("1", "1")
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "NUMBA_NUM_THREADS" not in os.environ
