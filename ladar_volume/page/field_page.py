"""The page and its stream of states over HTTP: server-sent events, nothing from the internet.

It listens on loopback. Where another address is given, a token is needed, and every request must
bring it. On loopback only requests for this host are answered, so that no foreign page in the
browser can read along.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import threading
import time
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from pathlib import Path

import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route
from uvicorn.protocols.http.h11_impl import H11Protocol

from ladar_volume.model.errors import ConfigurationError, OutputError
from ladar_volume.page.feed import Feed
from ladar_volume.page.place import place_of

PAGE = Path(__file__).with_name("page.html")
#: How often the stream looks for a change, and says that it is alive, s.
LOOK_S, ALIVE_S = 0.5, 10.0
#: The server has this long to start, s.
START_S = 10.0
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; "
        "connect-src 'self'; img-src data:; frame-ancestors 'none'"
    ),
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
#: Shortest token.
TOKEN = 12
#: Most connections at a time, and how long one may take to ask for something, s: those who hold
#: more would take the files that the log needs.
MOST, PATIENCE_S = 32, 10.0


class FewConnections(H11Protocol):
    """Closes what is one too many, and what asks for nothing."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """A client has connected."""
        super().connection_made(transport)
        if len(self.connections) > MOST:
            transport.abort()
        else:
            self.loop.call_later(PATIENCE_S, self.close_silent, transport)

    def close_silent(self, transport: asyncio.Transport) -> None:
        """Close a connection without a whole request."""
        if self.cycle is None:
            transport.abort()


@dataclass(frozen=True)
class Address:
    """Where the page is served; token : empty on loopback alone."""

    host: str
    port: int
    token: str = ""

    @property
    def url(self) -> str:
        """What to open."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{host}:{self.port}/" + (f"?token={self.token}" if self.token else "")


def address_of(text: str, token: str | None) -> Address:
    """The address of the page. Raises :class:`ConfigurationError`: any but loopback needs a
    token.
    """
    place = place_of(text, "--page")
    if token is not None and (len(token) < TOKEN or not token.isalnum() or not token.isascii()):
        raise ConfigurationError(f"--page-token: at least {TOKEN} letters and digits")
    if not place.own and token is None:
        raise ConfigurationError(
            f"--page {text}: others can reach this address: give --page-token", value=text
        )
    return Address(place.host, place.port, token or "")


def app_of(feed: Feed, address: Address, ending: threading.Event) -> Starlette:
    """The page at ``/`` and its events at ``/events``, which end with ``ending``."""
    page = PAGE.read_text(encoding="utf-8")

    def refuse_wrong_token(request: Request) -> Response | None:
        given = request.query_params.get("token", "")
        if address.token and not hmac.compare_digest(given.encode(), address.token.encode()):
            return PlainTextResponse("the token is missing or wrong", 403, HEADERS)
        return None

    async def show(request: Request) -> Response:
        return refuse_wrong_token(request) or HTMLResponse(page, headers=HEADERS)

    async def events(request: Request) -> Response:
        return refuse_wrong_token(request) or StreamingResponse(
            states(feed, request, ending), media_type="text/event-stream", headers=HEADERS
        )

    hosts = ["localhost", "127.0.0.1", "[::1]"] if not address.token else ["*"]
    guard = Middleware(TrustedHostMiddleware, allowed_hosts=hosts, www_redirect=False)
    return Starlette(routes=[Route("/", show), Route("/events", events)], middleware=[guard])


async def states(feed: Feed, request: Request, ending: threading.Event) -> AsyncIterator[str]:
    """The state as an event whenever it changed, and a comment where it has not for long."""
    seen, said = -1, time.monotonic()
    while not ending.is_set() and not await request.is_disconnected():
        now = time.monotonic()
        if feed.number != seen:
            seen, said = feed.number, now
            yield f"data: {feed.text()}\n\n"
        elif now - said > ALIVE_S:
            said = now
            yield ": alive\n\n"
        await asyncio.sleep(LOOK_S)


@contextlib.contextmanager
def serve_page(feed: Feed, address: Address) -> Iterator[Address]:
    """Serve the page in a thread while the block runs; the address with the port that was taken.
    Raises :class:`OutputError` where the address is not free.
    """
    ending = threading.Event()
    config = uvicorn.Config(
        app_of(feed, address, ending),
        host=address.host,
        port=address.port,
        http=FewConnections,
        log_level="error",
        access_log=False,
        timeout_graceful_shutdown=3,
        server_header=False,
    )
    server = uvicorn.Server(config)
    try:
        socket = config.bind_socket()
    except (SystemExit, OSError) as error:
        raise OutputError(
            f"--page: {address.host}:{address.port} cannot be used: it is taken, or not ours",
            reason="output_address",
            value=address.port,
        ) from error
    thread = threading.Thread(
        target=server.run, kwargs={"sockets": [socket]}, name="page", daemon=True
    )
    thread.start()
    try:
        deadline = time.monotonic() + START_S
        while not server.started and thread.is_alive() and time.monotonic() < deadline:
            time.sleep(0.01)
        yield Address(address.host, int(socket.getsockname()[1]), address.token)
    finally:
        ending.set()
        server.should_exit = True
        thread.join(timeout=5.0)
        socket.close()
