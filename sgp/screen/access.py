"""Who may use the screen: requests of the page it serves, with the token, from this computer."""

from __future__ import annotations

import hmac
import json
import tempfile
from collections.abc import Awaitable, Callable, Iterator, MutableMapping
from contextlib import contextmanager
from http import HTTPStatus
from pathlib import Path
from typing import Any, Final

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

MOST_BODY: Final = 64 * 1024
_MOST_ADDRESS: Final = 2048
POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS: Final = (
    (b"content-security-policy", POLICY.encode()),
    (b"cache-control", b"no-store"),
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
)


class Access:
    """Lets requests through to an app, without the token in their path, or refuses them.

    A request is refused, before anything is done, if its Host is not this server (a foreign name
    that resolves to this computer), its Origin is another page, its method or body is not one that
    the page sends, or its path does not begin with the token.

    Parameters
    ----------
    app
        The app behind it.
    token
        The secret in the address of the page.
    port
        Port of the server.
    """

    def __init__(self, app: App, token: str, port: int) -> None:
        self._app = app
        self._token = token.encode()
        self._hosts = {f"{name}:{port}".encode() for name in ("127.0.0.1", "localhost")}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection."""
        if scope["type"] != "http":
            if scope["type"] == "websocket":
                await send({"type": "websocket.close", "code": 1008})
            return
        refusal = self._refusal(scope)
        if refusal is not None:
            await _refuse(send, refusal)
            return

        async def sent(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", ()), *_HEADERS]
            await send(message)

        path = scope["path"].split("/", 2)
        inner = {**scope, "path": "/" + (path[2] if len(path) > 2 else "")}
        await self._app(inner, receive, sent)

    def _refusal(self, scope: Scope) -> int | None:
        """Return the status of a refusal, or None."""
        headers: dict[bytes, list[bytes]] = {}
        for name, value in scope["headers"]:
            headers.setdefault(name, []).append(value)
        hosts = headers.get(b"host", [])
        if len(hosts) != 1 or hosts[0] not in self._hosts:
            return 421
        if any(origin != b"http://" + hosts[0] for origin in headers.get(b"origin", [])):
            return 403
        site = headers.get(b"sec-fetch-site", [b"same-origin"])[0]
        # A link elsewhere, such as that of `private_link`, may only lead to the page itself.
        page = scope["path"].split("/")[2:] == [""]
        linked = page and headers.get(b"sec-fetch-dest") == [b"document"]
        if site not in (b"same-origin", b"none") and not linked:
            return 403
        if scope["method"] not in ("GET", "POST"):
            return 405
        if len(scope["path"]) + len(scope["query_string"]) > _MOST_ADDRESS:
            return 414
        token = scope["path"].split("/", 2)[1] if "/" in scope["path"] else ""
        if not hmac.compare_digest(token.encode("utf-8", "surrogateescape"), self._token):
            return 404
        if scope["method"] == "GET":
            return None
        return self._post_refusal(headers)

    @staticmethod
    def _post_refusal(headers: dict[bytes, list[bytes]]) -> int | None:
        if b"origin" not in headers:
            return 403
        if headers.get(b"content-type") != [b"application/json"]:
            return 415
        length = headers.get(b"content-length", [b""])[0]
        if b"transfer-encoding" in headers or not length.isdigit():
            return 411
        return 413 if int(length) > MOST_BODY else None


async def _refuse(send: Send, status: int) -> None:
    body = json.dumps({"error": HTTPStatus(status).phrase}).encode()
    length = (b"content-length", str(len(body)).encode())
    headers = [length, (b"content-type", b"application/json"), (b"connection", b"close"), *_HEADERS]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})


@contextmanager
def private_link(address: str) -> Iterator[str]:
    """Yield the address of a file that only this user can read, and that leads to a page.

    All users of the computer see the arguments of the browser, and so must not see the secret.
    """
    with tempfile.TemporaryDirectory(prefix="sgp-") as folder:
        file = Path(folder) / "page.html"
        file.touch(mode=0o600)
        file.write_text(
            '<!doctype html><meta charset="utf-8"><title>Capture preview</title>'
            f'<meta http-equiv="refresh" content="0; url={address}"><a href="{address}">Open</a>\n',
            encoding="utf-8",
        )
        yield file.as_uri()
