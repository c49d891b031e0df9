"""A connection that breaks costs what was on its way, and nothing that was here."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest
from hub_content import BOXES, LARGE_FILE

from nw_base.errors import FetchError
from nw_eval import api

REFERENCE = "hub:lab/corridor"


def starts(hub):
    """From which byte on each transfer of the large file was asked for."""
    return [int((call.range or "bytes=0-")[6:-1]) for call in hub.calls if call.origin == "cdn"]


@pytest.mark.usefixtures("place")
def test_a_connection_that_breaks_is_gone_on_with_where_it_broke(hub, ears):
    hub.breaks = [700_000, 800_000]
    fetched = api.fetch_scene(REFERENCE, listener=ears)
    assert (fetched.folder / "notes" / "large.bin").read_bytes() == LARGE_FILE
    first, second, third = starts(hub)
    assert first == 0
    assert 400_000 < second <= 700_000
    assert second + 500_000 < third <= second + 800_000
    assert sum("going on from there" in line for line in ears.messages) == 2


@pytest.mark.usefixtures("place")
def test_a_network_that_is_lost_for_good_is_told_with_what_is_here_and_what_comes_next(hub):
    hub.breaks = [900_000, 0, 0, 0]
    with pytest.raises(FetchError) as caught:
        api.fetch_scene(REFERENCE)
    text = str(caught.value)
    assert text.startswith(f"{REFERENCE}: cannot reach {hub.url}: ")
    assert (
        "900 kB of 2 MB of notes/large.bin are here; run the same command again to resume" in text
    )
    hub.calls.clear()
    fetched = api.fetch_scene(REFERENCE)
    assert starts(hub) == [900_000]
    assert (fetched.folder / "notes" / "large.bin").read_bytes() == LARGE_FILE


_FETCH = "import sys; from nw_eval import api; api.fetch_scene(sys.argv[1])"


@pytest.mark.usefixtures("place")
def test_a_process_that_is_killed_leaves_what_came_to_the_next(hub, tmp_path):
    hub.stalls_after = 1_500_000
    child = subprocess.Popen([sys.executable, "-c", _FETCH, REFERENCE], env=dict(os.environ))
    parts = tmp_path / "cache" / "hub" / "scene" / "lab" / "corridor" / ".parts"
    try:
        deadline = time.monotonic() + 60
        while not any(part.stat().st_size > 10**6 for part in parts.glob("*")):
            assert time.monotonic() < deadline
            time.sleep(0.02)
    finally:
        child.send_signal(signal.SIGKILL)
        child.wait()
    hub.stalls_after = None
    hub.calls.clear()
    fetched = api.fetch_scene(REFERENCE)
    (start,) = starts(hub)
    assert start > 10**6
    assert (fetched.folder / "notes" / "large.bin").read_bytes() == LARGE_FILE
    assert not list(parts.iterdir())


@pytest.mark.usefixtures("place")
def test_a_server_that_knows_no_ranges_sends_all_of_it_again(hub):
    hub.knows_ranges = False
    hub.breaks = [600_000]
    fetched = api.fetch_scene(REFERENCE)
    assert (fetched.folder / "notes" / "large.bin").read_bytes() == LARGE_FILE


def test_a_revision_that_changes_while_one_waits_has_bytes_of_its_own(hub, place):
    hub.breaks = [900_000, 0, 0, 0]
    with pytest.raises(FetchError):
        api.fetch_scene(REFERENCE)
    other = bytes(reversed(LARGE_FILE))
    commit = place.commit({"notes/large.bin": other})
    fetched = api.fetch_scene(REFERENCE)
    assert fetched.revision == commit
    assert (fetched.folder / "notes" / "large.bin").read_bytes() == other


@pytest.mark.usefixtures("place")
def test_bytes_that_are_not_those_that_were_announced_are_refused(hub):
    hub.sent["collision.yaml"] = BOXES.replace(b"0.1", b"0.9")
    with pytest.raises(FetchError, match=r"collision\.yaml is not what http://127\S+ announced"):
        api.fetch_scene(REFERENCE)
    hub.sent.clear()
    assert api.fetch_scene(REFERENCE).files


@pytest.mark.usefixtures("place")
def test_a_server_that_sends_more_than_it_announced_fills_no_disk(hub, tmp_path):
    hub.sent["collision.yaml"] = b"x" * 40_000
    with pytest.raises(FetchError, match="is not what"):
        api.fetch_scene(REFERENCE)
    assert sum(path.stat().st_size for path in tmp_path.rglob("*") if path.is_file()) < 2_010_000
