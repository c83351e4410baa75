"""Who may use the operator's screen: requests that its page does not send are refused."""

from __future__ import annotations

import json
import random
import socket
import time
from collections.abc import Iterator
from contextlib import suppress

import pytest

from sgp.screen.access import MOST_BODY
from sgp.screen.server import ScreenServer
from tests.cases import cases
from tests.sgp.screen_rig import LitRig, Served, served, until

LIGHT = {"do": "light", "mode": "one", "leds": [3], "exposure_us": 5000.0}
BODY = json.dumps(LIGHT).encode()
BAD_REQUESTS = 1000


@pytest.fixture(scope="module")
def rig() -> Iterator[LitRig]:
    made = LitRig()
    yield made
    made.close()


@pytest.fixture(scope="module")
def page(rig: LitRig, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """A page whose live picture is paused, so that nothing is lit."""
    with served(rig, tmp_path_factory.mktemp("recordings")) as made:
        made.station.pause(True)
        yield made
    assert made.errors == []


@pytest.fixture(autouse=True)
def nothing_lit(rig: LitRig, page: Served) -> Iterator[None]:
    """After each test, nothing was lit, and the server answers."""
    until(lambda: page.station.state()["rig"])
    start_ns = time.monotonic_ns()
    yield
    assert page.station.current_light.leds == (0,)
    assert rig.lit_since(start_ns) == set()
    assert page.get("")[0] == 200


def refused(page: Served, method: str, place: str, **headers: str | None) -> int:
    """Return the status of a refusal, which contains nothing of the page."""
    sent = {name.replace("_", "-"): value for name, value in headers.items()}
    code, body = page.send(method, place, BODY if method == "POST" else b"", sent)
    assert code >= 400
    assert b"Capture preview" not in body
    return code


@cases(
    "host",
    {
        "a name that resolves to this computer": "rig.example:{port}",
        "another port": "127.0.0.1:1",
        "no port": "127.0.0.1",
        "another address": "127.0.0.2:{port}",
        "all addresses": "0.0.0.0:{port}",
        "IPv6": "[::1]:{port}",
        "user": "127.0.0.1:{port}@evil.example",
        "a dot": "localhost.:{port}",
        "empty": "",
        "none": None,
    },
)
@pytest.mark.parametrize("method", ["GET", "POST"])
def test_a_foreign_host_is_refused(page: Served, host: str | None, method: str) -> None:
    place = page.path + ("do" if method == "POST" else "")
    host = host if host is None else host.format(port=page.port)
    assert refused(page, method, place, Host=host) in (400, 421)


@cases(
    "origin",
    {
        "another page": "http://evil.example",
        "another port": "http://127.0.0.1:1",
        "https": "https://127.0.0.1:{port}",
        "the other name": "http://localhost:{port}",
        "longer": "http://127.0.0.1:{port}.evil.example",
        "a file": "null",
        "empty": "",
    },
)
@pytest.mark.parametrize("method", ["GET", "POST"])
def test_a_foreign_origin_is_refused(page: Served, origin: str, method: str) -> None:
    place = page.path + ("do" if method == "POST" else "frame")
    assert refused(page, method, place, Origin=origin.format(port=page.port)) == 403


def test_an_action_needs_an_origin(page: Served) -> None:
    assert refused(page, "POST", page.path + "do", Origin=None) == 403


@pytest.mark.parametrize("site", ["cross-site", "same-site", "unknown"])
def test_what_another_site_requests_is_refused(page: Served, site: str) -> None:
    assert refused(page, "GET", page.path, Sec_Fetch_Site=site) == 403
    assert refused(page, "POST", page.path + "do", Sec_Fetch_Site=site) == 403


def test_a_link_elsewhere_leads_only_to_the_page(page: Served) -> None:
    link = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Dest": "document"}
    assert page.get("", **link)[0] == 200
    for name in ("frame", "events", "assets/main.js", "assets/"):
        assert page.get(name, **link)[0] == 403
    assert page.send("GET", "/wrong/", headers=link)[0] == 404
    assert page.send("POST", page.path + "do", BODY, link)[0] == 403
    assert page.send("POST", page.path, BODY, link)[0] == 405


@cases(
    "token",
    {
        "none": "",
        "wrong": "A" * 32,
        "cut": "{token_cut}",
        "longer": "{token}x",
        "other case": "{swapped}",
        "not text": "%ff%fe",
        "NUL": "{token}%00",
    },
)
@pytest.mark.parametrize("name", ["", "events", "frame", "do", "assets/main.js", "picture"])
def test_without_the_token_there_is_nothing(page: Served, token: str, name: str) -> None:
    own = page.path.strip("/")
    token = token.format(token=own, token_cut=own[:-1], swapped=own.swapcase())
    place = f"/{token}/{name}" if token else f"/{name}"
    assert refused(page, "GET", place) == 404
    assert refused(page, "POST", place) == 404


@pytest.mark.parametrize("method", ["PUT", "DELETE", "OPTIONS", "HEAD", "TRACE", "PATCH"])
def test_other_methods_are_refused(page: Served, method: str) -> None:
    assert refused(page, method, page.path + "do") == 405


@cases(
    ("headers", "status"),
    {
        "a form": ({"Content-Type": "application/x-www-form-urlencoded"}, 415),
        "text": ({"Content-Type": "text/plain"}, 415),
        "a charset": ({"Content-Type": "application/json; charset=utf-16"}, 415),
        "no type": ({"Content-Type": None}, 415),
        "no length": ({"Content-Length": None}, 411),
        "in chunks": ({"Content-Length": None, "Transfer-Encoding": "chunked"}, 411),
        "in chunks, with a length": ({"Transfer-Encoding": "chunked"}, 411),
        "too long": ({"Content-Length": str(MOST_BODY + 1)}, 413),
        "far too long": ({"Content-Length": "9" * 18}, 413),
    },
)
def test_bodies_of_another_kind_are_refused(
    page: Served, headers: dict[str, str | None], status: int
) -> None:
    code, body = page.send("POST", page.path + "do", BODY, headers)
    assert code == status
    assert json.loads(body)["error"]


@cases(
    "body",
    {
        "empty": b"",
        "not JSON": b"{",
        "not UTF-8": b'{"do": "stop\xff"}',
        "deep": b"[" * 60_000,
        "a list": b"[]",
        "no action": b"{}",
        "an unknown action": b'{"do": "dance"}',
        "an unknown key": b'{"do": "stop", "now": true}',
        "a number as text": BODY.replace(b"[3]", b'["3"]'),
        "a negative LED": BODY.replace(b"[3]", b"[-1]"),
        "too many LEDs": BODY.replace(b"[3]", json.dumps([0] * 5000).encode()),
        "NaN": BODY.replace(b"5000.0", b"NaN"),
        "infinity": BODY.replace(b"5000.0", b"1e999"),
    },
)
def test_what_is_no_action_is_refused(page: Served, body: bytes) -> None:
    code, answer = page.send("POST", page.path + "do", body, {"X-Page": "test"})
    assert code == 422
    assert json.loads(answer)["error"]


@cases(
    "name",
    {
        "above": "assets/../server.py",
        "above, escaped": "assets/%2e%2e%2fserver.py",
        "backslash": "assets/..%5cserver.js",
        "absolute": "assets//etc/passwd",
        "absolute, escaped": "assets/%2fetc%2fpasswd.js",
        "NUL": "assets/main.js%00.css",
        "source": "assets/server.py",
        "a folder": "assets/js",
        "long": "assets/" + "a" * 900 + ".js",
        "picture above": "picture?name=../session.toml",
        "picture, absolute": "picture?name=/etc/passwd",
        "picture with NUL": "picture?name=%00",
        "picture with a long name": "picture?name=" + "a" * 900,
        "picture of the folder": "picture?name=..",
        "no picture": "picture",
    },
)
def test_only_the_files_of_the_page_are_served(page: Served, name: str) -> None:
    assert page.get(name)[0] == 404


def test_a_long_address_is_refused(page: Served) -> None:
    assert page.get("x" * 3000)[0] == 414
    assert page.get("frame?after=" + "1" * 3000)[0] == 414


@cases(
    "query",
    {
        "nothing": "",
        "no region": "after=0",
        "no number": "after=x&left=0&top=0&width=1&height=1&columns=1&rows=1&clipped=1&peaking=1",
    },
)
def test_a_picture_needs_its_region(page: Served, query: str) -> None:
    assert page.get(f"frame?{query}")[0] == 400


def malformed(random_: random.Random, page: Served) -> bytes:
    """Return random bytes, or a request of the page with some of its bytes changed."""
    if random_.random() < 0.3:
        return random_.randbytes(random_.randrange(1, 3000))
    head = (
        f"POST {page.path}do HTTP/1.1\r\nHost: 127.0.0.1:{page.port}\r\nX-Page: test\r\n"
        f"Origin: http://127.0.0.1:{page.port}\r\nContent-Type: application/json\r\n"
        f"Content-Length: {len(BODY)}\r\n\r\n"
    )
    # Only the first part is damaged, where every byte counts.
    data = bytearray(head.encode() + BODY)
    for _ in range(random_.randrange(1, 20)):
        at = random_.randrange(len(head) // 3)
        data[at : at + random_.randrange(1, 4)] = random_.randbytes(random_.randrange(0, 4))
    return bytes(data[: random_.randrange(1, len(data) + 1)])


def test_malformed_requests_do_nothing(page: Served, caplog: pytest.LogCaptureFixture) -> None:
    random_ = random.Random(82)
    open_links = []
    for _ in range(BAD_REQUESTS):
        link = socket.create_connection(("127.0.0.1", page.port), timeout=60)
        with suppress(ConnectionError):  # closed before the end
            link.sendall(malformed(random_, page))
        if random_.random() < 0.02:
            open_links.append(link)  # which sends no more
        else:
            link.close()
    assert page.get("")[0] == 200
    for link in open_links:
        link.close()
    assert caplog.text == ""  # no lines in the terminal


def test_the_page_may_not_be_framed_or_stored(page: Served) -> None:
    with socket.create_connection(("127.0.0.1", page.port), timeout=10) as link:
        link.sendall(f"GET {page.path} HTTP/1.0\r\nHost: 127.0.0.1:{page.port}\r\n\r\n".encode())
        head = b""
        while data := link.recv(4096):
            head += data
    head = head.partition(b"\r\n\r\n")[0].lower()
    for header in (
        b"cache-control: no-store",
        b"x-content-type-options: nosniff",
        b"referrer-policy: no-referrer",
        b"frame-ancestors 'none'",
        b"default-src 'none'",
    ):
        assert header in head
    assert b"server:" not in head


def test_each_start_has_another_token(page: Served) -> None:
    servers = [
        ScreenServer(page.station, page.screen.perform, page.screen.picture) for _ in range(2)
    ]
    tokens = {server.address.rsplit("/", 2)[1] for server in servers}
    for server in servers:
        server._socket.close()
    assert len(tokens | {page.path.strip("/")}) == 3
    assert min(map(len, tokens)) >= 32


def test_other_addresses_do_not_answer(page: Served) -> None:
    for address in ("127.0.0.2", "::1"):
        with pytest.raises(OSError, match=r"refused|unreachable|assign|supported"):
            socket.create_connection((address, page.port), timeout=60)
