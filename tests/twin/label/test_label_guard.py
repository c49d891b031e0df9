"""Other web pages cannot speak to the label page, though they run in a browser of this machine."""

import asyncio
import http.client
from urllib.parse import urlsplit

import pytest
from label_places import opened

from nw_base.errors import PrerequisiteError, UsageError
from nw_eval.viewing import browser
from nw_twin.label.label_page import LabelPage

viser = pytest.importorskip("viser")
websockets = pytest.importorskip("websockets.asyncio.client")
from websockets.exceptions import InvalidStatus  # noqa: E402 - as above.


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    with LabelPage(opened(tmp_path_factory.mktemp("guard"))) as page:
        yield page


def spoken_to(page, **headers):
    """Open a websocket as viser's page does; return the first bytes that it is sent."""
    url = f"ws://{urlsplit(page.url).netloc}"

    async def first():
        async with websockets.connect(
            url,
            subprotocols=[f"viser-v{viser.__version__}"],
            additional_headers=headers,
            max_size=None,
        ) as socket:
            return await socket.recv()

    return asyncio.run(first())


def answer(page, **headers):
    connection = http.client.HTTPConnection(urlsplit(page.url).netloc, timeout=60)
    connection.putrequest("GET", "/", skip_host="Host" in headers)
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.endheaders()
    response = connection.getresponse()
    response.read()
    connection.close()
    return response


def test_the_page_itself_is_spoken_to(page):
    assert spoken_to(page, Origin=page.url)


@pytest.mark.parametrize(
    "origin", ["https://evil.example", "http://127.0.0.1:1", "http://localhost", "null", ""]
)
def test_a_page_from_elsewhere_is_turned_away(page, origin):
    with pytest.raises(InvalidStatus) as caught:
        spoken_to(page, Origin=origin)
    assert caught.value.response.status_code == 403


@pytest.mark.parametrize(
    "host", ["evil.example", "localhost.evil.example", "127.0.0.1.evil.example:80", "10.0.0.1", "["]
)
def test_a_stranger_s_name_that_was_made_to_point_here_is_turned_away(page, host):
    assert answer(page, Host=host).status == 403


def test_through_a_tunnel_it_is_reached_under_another_port():
    assert browser.refusal(["localhost:9000"], ["http://localhost:9000"]) is None
    assert browser.refusal(["localhost:9000"], ["http://localhost:9001"]) is not None
    assert browser.refusal(["localhost:9000", "localhost:9000"], []) is not None


def test_no_other_page_shows_it_in_a_frame(page):
    response = answer(page)
    assert response.status == 200
    assert response.headers["Content-Security-Policy"] == "frame-ancestors 'none'"


def test_a_port_in_use_is_an_error_and_not_the_next_port(page, tmp_path):
    with pytest.raises(UsageError, match="in use"):
        LabelPage(opened(tmp_path), port=page.server.get_port())
    with pytest.raises(UsageError, match="--port"):
        LabelPage(opened(tmp_path), port=70_000)


def test_a_server_that_cannot_be_guarded_is_not_kept(monkeypatch):
    stopped = []

    class Otherwise:
        def __init__(self, **_):
            pass

        def stop(self):
            stopped.append(self)

    monkeypatch.setattr(viser, "ViserServer", Otherwise)
    with pytest.raises(PrerequisiteError, match="could not be kept out"):
        browser.viser_server(0, "a page")
    assert len(stopped) == 1


def test_it_prints_nothing(tmp_path, capfd):
    with LabelPage(opened(tmp_path)):
        pass
    captured = capfd.readouterr()
    assert captured.out == captured.err == ""
