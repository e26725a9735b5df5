"""Gate in front of a WebSocket server that refuses web pages of other sites by their ``Origin`` header.

Browsers let every page open ``ws://127.0.0.1`` and send the page's site as ``Origin``. A server has to refuse
foreign sites itself (RFC 6455, section 10.2); Foxglove's SDK does not. Electron applications send ``file://``
(RobotWebTools/rosbridge_suite, issue 485).
"""

import asyncio
import secrets
import threading
from contextlib import suppress
from typing import Self
from urllib.parse import urlsplit

LOOPBACK = "127.0.0.1"
APPS = frozenset({"https://app.foxglove.dev", "file://"})  # Foxglove's app in a browser and on the desktop
OWN_HOSTS = frozenset({"localhost", "127.0.0.1", "::1"})
REQUEST_S = 10.0  # s within which a client must send its request; untuned
PIECE_BYTES = 1 << 16
REFUSED = b"HTTP/1.1 403 Forbidden\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"


def hidden_address() -> str:
    """Return a random loopback address, too hard to find by a web page's port scan."""
    return "127." + ".".join(str(1 + secrets.randbelow(254)) for _ in range(3))


def is_admitted(request: bytes) -> bool:
    """Return whether a request may open a WebSocket: from a program, Foxglove's app, or a page of this
    machine.

    Programs send no ``Origin``. "null", which sandboxed pages of any site send, is refused.
    """
    lines = request.decode("latin-1").split("\r\n")[1:]
    fields = [line.split(":", 1) for line in lines if ":" in line]
    named = [(name.strip().lower(), value.strip().lower()) for name, value in fields]
    origins = [value for name, value in named if name == "origin"]
    if ("upgrade", "websocket") not in named or len(origins) > 1:
        return False
    if not origins or origins[0] in APPS:
        return True
    with suppress(ValueError):
        return urlsplit(origins[0]).hostname in OWN_HOSTS
    return False


class OriginGate:
    """Proxy on ``127.0.0.1`` that forwards admitted clients to a server; a context manager.

    behind: address and port of the server. port: 0 takes a free one. Raises OSError for a taken or forbidden
    port.
    """

    def __init__(self, port: int, behind: tuple[str, int]) -> None:
        self._behind = behind
        self._loop = asyncio.new_event_loop()
        try:
            self._server = self._loop.run_until_complete(asyncio.start_server(self._client, LOOPBACK, port))
        except BaseException:
            self._loop.close()
            raise
        self.port: int = self._server.sockets[0].getsockname()[1]
        self._thread = threading.Thread(target=self._loop.run_forever, name="origin gate", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        asyncio.run_coroutine_threadsafe(self._end(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    async def _end(self) -> None:
        self._server.close()
        clients = asyncio.all_tasks() - {asyncio.current_task()}
        for client in clients:
            client.cancel()
        await asyncio.gather(*clients, return_exceptions=True)

    async def _client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            with suppress(OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError, TimeoutError):
                request = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), REQUEST_S)
                if is_admitted(request):
                    await self._connect(request, reader, writer)
                else:
                    writer.write(REFUSED)
                    await writer.drain()
        finally:
            writer.close()

    async def _connect(
        self, request: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        """Pass bytes in both directions until either side ends."""
        back_reader, back_writer = await asyncio.open_connection(*self._behind)
        try:
            back_writer.write(request)
            ways = [
                asyncio.ensure_future(_pass(one, other))
                for one, other in ((reader, back_writer), (back_reader, writer))
            ]
            try:
                await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for way in ways:
                    way.cancel()
                await asyncio.gather(*ways, return_exceptions=True)
        finally:
            back_writer.close()


async def _pass(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while piece := await reader.read(PIECE_BYTES):
        writer.write(piece)
        await writer.drain()
