"""Whatever a program of this machine sends to the page: no traceback, and the page goes on."""

from __future__ import annotations

import asyncio
import dataclasses
import socket
import time
from random import Random
from typing import TYPE_CHECKING, Any

import pytest

from nw_eval.viewing.browser import stop, viser_server

viser = pytest.importorskip("viser")
msgspec = pytest.importorskip("msgspec")
websockets = pytest.importorskip("websockets")

from viser import _messages  # noqa: E402

if TYPE_CHECKING:
    from collections.abc import Iterator

KINDS = _messages.Message._subclass_from_type_string()
JUNK = ["x", None, float("nan"), [], {}, {"a": 1}, -1, 2**60, b"x", [1, 2, 3], ["a"] * 3, True]
pack = msgspec.msgpack.encode
# With it a browser counts as one that looks at the page.
CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": [1.0, 0.0, 0.0, 0.0],
    "position": [0.0, 0.0, 1.0],
    "fov": 1.0,
    "near": 0.1,
    "far": 9.0,
    "image_height": 100,
    "image_width": 100,
    "look_at": [1.0, 0.0, 0.0],
    "up_direction": [0.0, 0.0, 1.0],
}
NOT_MESSAGES = [
    *("a text", b"", b"\xc1", b"\x93", b"\x00" * 50, b"\x91" * 100_000, b"\xdd\xff\xff\xff\xff"),
    *(pack([1]), pack({}), pack({"type": 1}), pack({"type": "Nope"}), pack("x" * 1_000_000)),
    *(pack({"type": "GuiUpdateMessage"}), pack({"type": "GuiUpdateMessage", "nope": 1})),
    *(pack({"type": name}) for name in KINDS if name.startswith("ShareUrl")),
]


class Page:
    """A page with a control of each kind that nw-eval's have."""

    def __init__(self) -> None:
        self.server: Any = viser_server(0, "junk")
        gui = self.server.gui
        self.slider = gui.add_slider("time", min=0.0, max=9.0, step=0.5, initial_value=1.0)
        self.choice = gui.add_dropdown("trial", ("a", "b"), initial_value="a")
        self.others = gui.add_checkbox("mesh", initial_value=False)
        self.heard: list[float] = []
        self.slider.on_update(lambda _: self.heard.append(self.slider.value))
        self.choice.on_update(lambda _: {"a": 1, "b": 2}[self.choice.value])
        self.server.scene.on_click()(lambda _: None)

    def send(self, *frames: bytes | str, wait: float = 0.2) -> int | None:
        """Send frames on a connection of their own; return how the server closed it, if it did."""

        async def sending() -> int | None:
            address = f"ws://127.0.0.1:{self.server.get_port()}"
            protocols = [f"viser-v{viser.__version__}"]
            async with websockets.connect(address, subprotocols=protocols, max_size=None) as peer:
                try:
                    for frame in (pack(CAMERA), *frames):
                        await peer.send(frame)
                    pong = await peer.ping()
                    await pong
                    async with asyncio.timeout(wait):
                        while True:
                            await peer.recv()
                except TimeoutError:
                    return None
                except websockets.exceptions.ConnectionClosed as closed:
                    return closed.rcvd.code if closed.rcvd else 1006

        return asyncio.run(sending())

    def sets(self, uuid: Any, value: Any) -> bytes:
        return pack({"type": "GuiUpdateMessage", "uuid": uuid, "updates": value})

    def check_it_goes_on(self) -> None:
        """Fail if the page does no more what it is asked."""
        wanted = 2.0 if self.slider.value != 2.0 else 3.0
        assert self.send(self.sets(self.slider._impl.uuid, {"value": wanted})) is None
        end = time.monotonic() + 60.0
        while wanted not in self.heard[-1:]:
            assert time.monotonic() < end, "the page does not hear"
            time.sleep(0.02)


@pytest.fixture
def page() -> Iterator[Page]:
    shown = Page()
    yield shown
    stop(shown.server)


def test_a_frame_that_is_no_message_ends_its_connection_and_nothing_else(
    page: Page, capfd: pytest.CaptureFixture[str]
) -> None:
    assert {page.send(frame, wait=60.0) for frame in NOT_MESSAGES} == {1007}
    page.check_it_goes_on()
    printed = capfd.readouterr()
    assert printed.err == ""
    assert "Share" not in printed.out


def test_messages_with_values_of_any_kind_are_told_in_lines(
    page: Page, capfd: pytest.CaptureFixture[str]
) -> None:
    controls = [page.slider, page.choice, page.others]
    uuids = [*(each._impl.uuid for each in controls), "none", 5]
    values = [of for junk in JUNK for of in (junk, {"value": junk}, {"nope": junk})]
    frames = [page.sets(uuid, value) for uuid in uuids for value in values]
    random = Random(23)
    for name, kind in KINDS.items():
        if not name.startswith(("ShareUrl", "FileTransfer")):
            fields = [field.name for field in dataclasses.fields(kind) if field.init]
            frames.append(pack({"type": name, **{each: random.choice(JUNK) for each in fields}}))
    for frame in frames:
        page.send(frame, wait=0.01)
    page.check_it_goes_on()
    printed = capfd.readouterr().err
    assert "Traceback" not in printed
    lines = printed.splitlines()
    assert lines
    ours = "warning: the page could not do what it was sent: "
    assert [line for line in lines if not line.startswith(ours)] == []


def test_bytes_that_are_no_websocket_are_nobodys_news(
    page: Page, capfd: pytest.CaptureFixture[str]
) -> None:
    upgrade = (
        "GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
        f"Sec-WebSocket-Protocol: viser-v{viser.__version__}\r\n\r\n"
    )
    for first, then in ((b"\x00\xff\r\n\r\n", b""), (upgrade.encode(), bytes(range(256)))):
        with socket.create_connection(("127.0.0.1", page.server.get_port())) as peer:
            peer.sendall(first)
            peer.recv(1000)
            peer.sendall(then)
    page.check_it_goes_on()
    assert capfd.readouterr().err == ""
