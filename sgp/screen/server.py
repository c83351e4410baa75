"""The server of the page, in a separate thread: pictures, states and actions, on loopback."""

from __future__ import annotations

import asyncio
import json
import secrets
import socket
import time
from collections.abc import AsyncIterator, Callable
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import PurePosixPath
from typing import Final, Self

import cv2
import numpy as np
import uvicorn
from pydantic import ValidationError
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from acquisition.preview import Marks, Region, picture_of
from rig.arrays import UInt8
from rig.messages import validation_message
from sgp.cli.exit import UsageError, error_text
from sgp.screen.access import Access
from sgp.screen.actions import ACTION, Action
from sgp.screen.side_thread import SideThread
from sgp.screen.station import BusyError, Station

_LOOK_S: Final = 0.03
_LONGEST_WAIT_S: Final = 5.0
# A page that was closed loses control after this time; a reload takes less.
_CONTROL_S: Final = 3.0
_TYPES: Final = {".js": "text/javascript", ".css": "text/css", ".html": "text/html"}
_SHARED: Final = ("elements.js", "gestures.js")
_REGION: Final = ("left", "top", "width", "height")
_NUMBERS: Final = ("after", *_REGION, "columns", "rows", "clipped", "peaking")

Perform = Callable[[Action], None]
Pictures = Callable[[str], UInt8 | None]


class Control:
    """Which page controls the rig: the first, until it is closed."""

    def __init__(self) -> None:
        self._page = ""
        self._seen_s = 0.0

    def has(self, page: str) -> bool:
        """Return whether a page has control; without another one that has it, it gets it."""
        now_s = time.monotonic()
        if not page:
            return False
        if page != self._page and now_s - self._seen_s < _CONTROL_S:
            return False
        self._page, self._seen_s = page, now_s
        return True


class ScreenServer:
    """Serves the page of a station inside its ``with`` block.

    Parameters
    ----------
    station
        The station.
    perform
        Carries out an action of the page.
    pictures
        Returns a picture by its name: a thumbnail of a recorded frame, or a result.
    port
        Port of the server; 0 for a free one.

    Raises
    ------
    UsageError
        If the port cannot be used.
    """

    def __init__(
        self, station: Station, perform: Perform, pictures: Pictures, *, port: int = 0
    ) -> None:
        self._station, self._perform, self._pictures = station, perform, pictures
        self._control = Control()
        self._assets = _assets()
        self._socket = _bound(port)
        port = self._socket.getsockname()[1]
        token = secrets.token_urlsafe(24)
        self.address = f"http://127.0.0.1:{port}/{token}/"
        routes = [
            Route("/", self._page),
            Route("/assets/{name}", self._asset),
            Route("/events", self._events),
            Route("/frame", self._frame),
            Route("/picture", self._picture),
            Route("/do", self._do, methods=["POST"]),
        ]
        self._server = uvicorn.Server(
            uvicorn.Config(
                Access(Starlette(routes=routes), token, port),
                http="h11",
                ws="none",
                lifespan="off",
                log_config=None,
                log_level="critical",  # malformed requests are no lines in the terminal
                server_header=False,
                timeout_graceful_shutdown=1,
            )
        )
        self._side = SideThread(station, lambda: self._server.run(sockets=[self._socket]))

    def __enter__(self) -> Self:
        self._side.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.should_exit = True
        try:
            self._side.end()
        finally:
            self._socket.close()

    async def _page(self, request: Request) -> Response:
        return self._file("page.html")

    async def _asset(self, request: Request) -> Response:
        return self._file(request.path_params["name"])

    def _file(self, name: str) -> Response:
        if name not in self._assets:
            return _refused(404, "there is no such file")
        kind = _TYPES[PurePosixPath(name).suffix]
        return Response(self._assets[name].read_bytes(), media_type=kind)

    async def _events(self, request: Request) -> Response:
        page = request.query_params.get("page", "")
        return StreamingResponse(self._states(page), media_type="text/event-stream")

    async def _states(self, page: str) -> AsyncIterator[str]:
        """Yield the state whenever it changes, and at least once per second."""
        sent, sent_s = -1, 0.0
        while not self._station.closed:
            controls = self._control.has(page)
            if controls:
                self._station.attend()
            changes = self._station.changes
            now_s = time.monotonic()
            if changes != sent or now_s - sent_s > 1:
                sent, sent_s = changes, now_s
                state = await run_in_threadpool(self._station.state)
                yield f"data: {json.dumps({**state, 'controls': controls})}\n\n"
            await asyncio.sleep(_LOOK_S)

    async def _frame(self, request: Request) -> Response:
        """Send a region of the first frame after a given one."""
        try:
            asked = {name: int(request.query_params[name]) for name in _NUMBERS}
        except (KeyError, ValueError):
            return _refused(400, f"the address needs the whole numbers {', '.join(_NUMBERS)}")
        ends_s = time.monotonic() + _LONGEST_WAIT_S
        while (frame := self._station.frame) is None or frame.number <= asked["after"]:
            if self._station.closed or time.monotonic() > ends_s:
                return Response(status_code=204)
            await asyncio.sleep(_LOOK_S / 3)
        region = Region(*(asked[name] for name in _REGION)).within(frame.size)
        most = min(asked["rows"], 4096), min(asked["columns"], 4096)
        marks = Marks(bool(asked["clipped"]), bool(asked["peaking"]))
        picture = await run_in_threadpool(lambda: _encoded(picture_of(frame, region, most, marks)))
        place = [region.left, region.top, region.width, region.height]
        headers = {
            "x-frame": json.dumps({"number": frame.number, "leds": frame.leds, "region": place})
        }
        return Response(picture, media_type="image/bmp", headers=headers)

    async def _picture(self, request: Request) -> Response:
        name = request.query_params.get("name", "")
        picture = await run_in_threadpool(self._pictures, name)
        if picture is None:
            return _refused(404, f"there is no picture {name[:80]!r}")
        return Response(_encoded(picture, ".png"), media_type="image/png")

    async def _do(self, request: Request) -> Response:
        try:
            action = ACTION.validate_json(await request.body())
        except ValidationError as error:
            return _refused(422, validation_message(error))
        if not self._control.has(request.headers.get("x-page", "")):
            return _refused(409, "another page controls the rig: close it first")
        try:
            await run_in_threadpool(self._perform, action)
        except BusyError as error:
            return _refused(409, str(error))
        except (UsageError, ValueError) as error:
            return _refused(422, str(error))
        except Exception as error:  # noqa: BLE001
            return _refused(500, error_text(error))
        return JSONResponse({})


def _bound(port: int) -> socket.socket:
    bound = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind(("127.0.0.1", port))
        bound.listen()  # a browser that is faster than the server waits
    except OSError as error:
        bound.close()
        raise UsageError(
            f"--port {port}: cannot be used ({error.strerror}): another program may use it; give "
            "another port, or leave out --port"
        ) from error
    return bound


def _assets() -> dict[str, Traversable]:
    """Return the files of the page by name; some are those of the report."""
    screen, report = files("sgp.screen"), files("sgp.report")
    own = [screen / "page.html", screen / "screen.css", *(screen / "js").iterdir()]
    shared = [report / "style.css", *(report / "js" / name for name in _SHARED)]
    return {file.name: file for file in (*own, *shared)}


def _refused(status: int, text: str) -> JSONResponse:
    return JSONResponse({"error": text}, status_code=status)


def _encoded(picture: UInt8, suffix: str = ".bmp") -> bytes:
    # Without compression for live pictures: on loopback, encoding would take longer than sending.
    bgr = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR) if picture.ndim == 3 else picture
    done, data = cv2.imencode(suffix, np.ascontiguousarray(bgr))
    if not done:
        raise ValueError("the picture cannot be encoded")
    return data.tobytes()
