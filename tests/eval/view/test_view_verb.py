"""`nw-eval view` serves a page until a signal, where links of reports lead."""

import re
import signal
import socket
import subprocess
import sys
import urllib.request

import pytest

from nw_eval import cli
from nw_eval.viewing.browser import free_port
from nw_gate.results.moment_link import PORT

pytest.importorskip("viser")

FIRST = "hurdles-one_low_carpet-000"


def served(*arguments):
    """Start the verb; return its process and the address that it says."""
    command = [sys.executable, "-m", "nw_eval", "view", *map(str, arguments)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    line = process.stdout.readline()
    found = re.search(r"is at (http://127\.0\.0\.1:\d+); Ctrl-C ends it", line)
    if found is None:
        process.kill()
    return process, found[1]


@pytest.mark.parametrize(
    "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.nightly)]
)
def test_the_page_is_there_until_it_is_interrupted(log, number):
    process, address = served(log, "--port", "0", "--at", "0.5")
    with process:
        with urllib.request.urlopen(address) as answer:
            assert b"<html" in answer.read(2000)
        process.send_signal(number)
        assert process.wait(timeout=60) == 0
        assert process.stdout.read() == ""


def test_where_reports_lead_is_taken_unless_somebody_is_there():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        assert free_port(taken.getsockname()[1]) == 0
    assert free_port(PORT) in {0, PORT}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere"], "no log, run, scene or policy at 'nowhere'"),
        (["RUN", "--trial", "hurdles-one_low_carpet-0000"], FIRST),
        (["RUN", "--port", "99999"], "another --port"),
    ],
)
def test_what_cannot_be_served_is_said(runs, capsys, arguments, words):
    with pytest.raises(SystemExit) as left:
        cli.main(["view", *[str(runs[0]) if each == "RUN" else each for each in arguments]])
    assert left.value.code == 2
    assert words in capsys.readouterr().err
