"""A rig of a virtual board and a camera inside, and the page of its station."""

from __future__ import annotations

import http.client
import json
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol
from urllib.parse import urlsplit

from acquisition import CapturePlan
from rig import Board, Rig, RigConfig, find_rig_config, open_rig
from sgp.screen import Desk, Light, PlanSheet, Screen, Station
from sgp.screen.server import ScreenServer
from sgp.sessions import Order, StoredOptions
from simulator import Rendering, render, scene_named
from simulator.bench import BenchState
from simulator.camera import ImageFormation, VirtualCamera
from simulator.led_board import VirtualBoard

LEDS = 6
PLAN = CapturePlan(leds="0-5", exposures_us=(5000.0,))
FIRST = Light("one", (0,), 5000.0)
LIMIT_S = 120.0


class LitRig:
    """Opens rigs with one virtual board after the other, and knows which LED is on.

    Parameters
    ----------
    size
        Width and height of a frame in px.
    realtime
        Whether the camera waits for the exposure time.
    leds, dead
        Number of LEDs, and those that the rig file lists as dead.
    """

    def __init__(
        self,
        size: tuple[int, int] = (64, 52),
        *,
        realtime: bool = False,
        leds: int = LEDS,
        dead: tuple[int, ...] = (),
    ) -> None:
        self._view = _view(size, leds)
        self._scene = scene = self._view.scene
        self._realtime = realtime
        places = scene.lights.positions_mm
        assert places is not None
        positions = tuple((x, y, z) for x, y, z in places.tolist())
        self.config = RigConfig(
            name="small", driver="simulated", leds=leds, dead_leds=dead, led_positions_mm=positions
        )
        self.opened: list[Rig] = []
        self.failure: Exception | None = None
        self.connect()

    def connect(self) -> None:
        """Connect a board."""
        self.board = VirtualBoard(self.config.leds)
        self.state = BenchState(self.board.bench_state_path)

    def unplug(self) -> None:
        """Let the board disappear, as if its cable was pulled."""
        self.board.close()

    def open(self) -> Rig:
        """Open the rig."""
        if self.failure is not None:
            raise self.failure
        scene = self._scene
        board = Board(self.board.port)
        camera = VirtualCamera(
            self._view.plane,
            size=scene.lens.size,
            bench=BenchState(self.board.bench_state_path),
            formation=ImageFormation(noise=scene.noise, noisy=False, cfa=scene.lens.cfa),
            realtime=self._realtime,
        )
        self.opened.append(Rig(board, camera, self.config))
        return self.opened[-1]

    def lit(self) -> int | None:
        """Return the LED that is on."""
        return self.state.led(time.monotonic_ns())

    def lit_since(self, start_ns: int) -> set[int]:
        """Return the LEDs that were on after a time of the monotonic clock."""
        return {one.led for one in self.state.periods() if one.end_ns > start_ns}

    def close(self) -> None:
        self.state.close()
        self.board.close()


@cache
def _view(size: tuple[int, int], leds: int) -> Rendering:
    return render(scene_named("coin", width=size[0], height=size[1], leds=leds))


@dataclass
class Served:
    """A station with its page, and what tests ask of them."""

    station: Station
    desk: Desk
    screen: Screen
    address: str
    out: Path
    errors: list[BaseException] = field(default_factory=list)

    @property
    def port(self) -> int:
        port = urlsplit(self.address).port
        assert port is not None
        return port

    @property
    def path(self) -> str:
        """The path of the page, with its token."""
        return urlsplit(self.address).path

    def send(
        self,
        method: str,
        place: str,
        body: bytes = b"",
        headers: Mapping[str, str | None] = MappingProxyType({}),
    ) -> tuple[int, bytes]:
        """Send a request as the page would; headers replace its own, None leaves one out."""
        host = f"127.0.0.1:{self.port}"
        sent: dict[str, str | None] = {"Host": host}
        if method == "POST":
            sent |= {
                "Origin": f"http://{host}",
                "Content-Type": "application/json",
                "Content-Length": str(len(body)),
            }
        sent |= headers
        link = http.client.HTTPConnection("127.0.0.1", self.port, timeout=LIMIT_S)
        try:
            link.putrequest(method, place, skip_host=True, skip_accept_encoding=True)
            for name, value in sent.items():
                if value is not None:
                    link.putheader(name, value)
            link.endheaders(body)
            answer = link.getresponse()
            return answer.status, answer.read()
        finally:
            link.close()

    def get(self, name: str, **headers: str | None) -> tuple[int, bytes]:
        """Get something of the page by its name below the token."""
        return self.send("GET", self.path + name, headers=headers)

    def do(self, page: str = "test", **action: Any) -> tuple[int, str]:
        """Request an action as a page; return the status and the error."""
        body = json.dumps(action).encode()
        code, answer = self.send("POST", self.path + "do", body, {"X-Page": page})
        return code, json.loads(answer).get("error", "")

    @contextmanager
    def watched(self, page: str = "test") -> Iterator[Iterator[dict[str, Any]]]:
        """Be a page: yield the states that arrive."""
        link = http.client.HTTPConnection("127.0.0.1", self.port, timeout=LIMIT_S)
        link.request("GET", f"{self.path}events?page={page}")
        answer = link.getresponse()

        def states() -> Iterator[dict[str, Any]]:
            while line := answer.readline():
                if line.startswith(b"data: "):
                    yield json.loads(line[6:])

        try:
            yield states()
        finally:
            answer.close()
            link.close()

    def finished(self) -> dict[str, Any]:
        """Wait for the end of the task, with the operator there, and return the state."""

        def over() -> bool:
            self.station.attend()
            return self.station.state()["task"] is None

        until(over)
        return self.station.state()


def until(holds: Callable[[], object], limit_s: float = LIMIT_S) -> None:
    """Wait until something holds."""
    ends_s = time.monotonic() + limit_s
    while not holds():
        assert time.monotonic() < ends_s
        time.sleep(0.01)


class RigSource(Protocol):
    """What opens rigs of one configuration."""

    config: RigConfig

    def open(self) -> Rig:
        """Open the rig."""
        ...


class RigFile:
    """Opens the rig of a rig file."""

    def __init__(self, path: Path) -> None:
        self._name = str(path)
        self.config = find_rig_config(self._name)

    def open(self) -> Rig:
        """Open the rig."""
        return open_rig(self._name)


@contextmanager
def served(
    rig: RigSource,
    out: Path,
    *,
    plan: CapturePlan = PLAN,
    pixel_mm: float | None = None,
    light: Light = FIRST,
) -> Iterator[Served]:
    """Run a station with its page in threads."""
    desk = Desk(PlanSheet(plan, rig.config))
    station = Station(rig.open, desk, light)
    screen = Screen(
        station, desk, Order("small", StoredOptions(), "Ada", None, None), out, pixel_mm
    )
    errors: list[BaseException] = []

    def run() -> None:
        try:
            station.run()
        except BaseException as error:  # noqa: BLE001 - the test looks at it
            errors.append(error)

    thread = threading.Thread(target=run)
    with ScreenServer(station, screen.perform, screen.picture) as server:
        thread.start()
        try:
            yield Served(station, desk, screen, server.address, out, errors)
        finally:
            station.close()
            thread.join(LIMIT_S)
    assert not thread.is_alive()
