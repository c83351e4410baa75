"""The station: operates a rig for a screen, one task at a time.

`Station.run` owns the rig and the signals, on the main thread (decision 9). All other methods may
be called from any thread: they change settings, request a task, or stop it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from typing import Any, Final, Literal

import rig as rigs
from acquisition.engine import StopRequest
from acquisition.engine.stop_request import StoppedError
from acquisition.preview import Composite, LiveFrame, Region
from sgp.cli.console import note
from sgp.cli.exit import error_text
from sgp.screen.desk import Desk
from sgp.screen.tasks import Task

Mode = Literal["one", "cycle", "all"]

# Without a sign of a page for so long, nothing is lit.
AWAY_S: Final = 10.0
_ABSENCE: Final = "the closing of the page"
_REOPEN_S: Final = 1.0
_IDLE_S: Final = 0.05
# A stop turns the LEDs off again and again, in case a shot was about to begin, for so long.
_STOPPING_S: Final = 2.0


class BusyError(Exception):
    """A task is running, or the rig is not open."""


@dataclass(frozen=True)
class Light:
    """What lights the live picture.

    Parameters
    ----------
    mode
        ``one`` LED; a ``cycle`` through LEDs, one after the other; or ``all``: the mean of a cycle.
    leds
        The LEDs; none for a frame with all LEDs off.
    exposure_us, gain_db
        Exposure time and gain of each frame.
    """

    mode: Mode = "one"
    leds: tuple[int, ...] = (0,)
    exposure_us: float = 20_000.0
    gain_db: float = 0.0


@dataclass
class _Live:
    """The live picture: what is requested, and the latest frame."""

    light: Light
    possible: Light | None = None  # the last one that the rig accepted
    refusal: str = ""
    region: Region | None = None
    paused: bool = False
    number: int = 0
    turn: int = 0
    composite: Composite = field(default_factory=Composite)
    frame: LiveFrame | None = None
    figures: dict[str, Any] = field(default_factory=dict)
    taken_s: float = 0.0
    rate_hz: float = 0.0


class Station:
    """A rig, operated for a screen.

    Parameters
    ----------
    open_rig
        Opens the rig; called again after the rig failed.
    desk
        What the tasks share with the screen.
    light
        What lights the live picture at first.
    black_dn
        Grey value of the camera without light.
    always_attended
        True if the operator is always there, as at a terminal.
    """

    def __init__(
        self,
        open_rig: Callable[[], rigs.Rig],
        desk: Desk,
        light: Light,
        *,
        black_dn: float = 0.0,
        always_attended: bool = False,
    ) -> None:
        self._open_rig = open_rig
        self.desk = desk
        self._always_attended = always_attended
        self._lock = threading.RLock()
        self._black_dn = black_dn
        self._live = _Live(light)
        self._rig: rigs.Rig | None = None
        self._trouble = "opening the rig"
        self.confirmed_off = False
        self._task: tuple[str, Task] | None = None
        self._stop = StopRequest()
        self._closing = False
        self._shooting = False
        self._cut = False  # whether the latest exposure was ended early
        self._seen_s = time.monotonic()
        self._changes = 0

    # Called by the thread that owns the rig.

    def run(self) -> None:
        """Operate the rig until `close` is called or Ctrl-C is pressed; all LEDs are off then.

        Raises
        ------
        KeyboardInterrupt
            If Ctrl-C ended a task.
        """
        watch = threading.Thread(target=self._watch, daemon=True)
        watch.start()
        try:
            while not self._closing:
                opened = self._opened()
                if opened is None:
                    continue
                try:
                    with opened:
                        self._operate(opened)
                except rigs.RigError as error:
                    self._fail(error)
                finally:
                    with self._lock:
                        self._rig = None
        except KeyboardInterrupt:
            if self._task is not None:
                raise
        finally:
            self._task = None
            self.close()
            watch.join()

    def _watch(self) -> None:
        """In another thread: end exposure and task when the operator is away."""
        while not self._closing:
            if not self._attended and (self._shooting or self._task is not None):
                self._end(_ABSENCE)
            time.sleep(_IDLE_S)

    def _opened(self) -> rigs.Rig | None:
        try:
            opened = self._open_rig()
        except rigs.RigError as error:
            self._fail(error)
            self._rest(_REOPEN_S)
            return None
        with self._lock:
            self._rig, self._trouble, self.confirmed_off = opened, "", True
            self._live.composite, self._live.turn = Composite(), 0
            self._changed()
        return opened

    def _operate(self, rig: rigs.Rig) -> None:
        while not self._closing:
            with self._lock:
                task = self._task
                self._shooting = task is None and self._attended and not self._live.paused
                self._cut = False
            if task is not None:
                self._carry_out(*task, rig)
            elif self._shooting:
                self._shoot(rig)
            else:
                self._rest(_IDLE_S)

    def _carry_out(self, name: str, task: Task, rig: rigs.Rig) -> None:
        """Carry out a task; what fails is shown, and only a failure of the hardware is raised."""
        self.desk.begin(self._stop, self._changed)
        failure, broken = "", False
        try:
            task(rig, self.desk)
        except KeyboardInterrupt as error:
            if not isinstance(error, StoppedError) or self._stop.asked_by == "Ctrl-C":
                raise
            failure = f"stopped by {self._stop.asked_by}"
        except Exception as error:  # noqa: BLE001
            failure = error_text(error)
            if self._stop.asked and isinstance(error, rigs.RigError):
                failure = f"stopped by {self._stop.asked_by}"  # it turned the LED of a shot off
            else:
                broken = isinstance(error, rigs.BoardError | rigs.CameraError)
            if not self._stop.asked and not broken:
                note(f"error: {name}: {failure}")
        with suppress(rigs.RigError):
            rig.off()
        self.desk.end(failure)
        with self._lock:
            self._task = None
            self._changed()
        if broken:
            raise rigs.RigError(failure)

    def _shoot(self, rig: rigs.Rig) -> None:
        with self._lock:
            live = self._live
            light, turn = live.light, live.turn
        led = light.leds[turn % len(light.leds)] if light.leds else None
        try:
            if light != live.possible:
                self._prepare(rig, light)
            if live.light is not light:
                return  # refused, or changed meanwhile
            shot = rig.shoot(led, light.exposure_us, light.gain_db)
        except rigs.RigError as error:
            if self._cut:
                return
            if not isinstance(error, rigs.FrameLostError):
                raise
            self._report(error_text(error))
            self._rest(_IDLE_S)
            return
        finally:
            self._shooting = False
        self._keep(LiveFrame.of(live.number + 1, shot, rig, self._black_dn), light)

    def _prepare(self, rig: rigs.Rig, light: Light) -> None:
        """Go back to the light before, if the rig refuses this one: it is not broken."""
        live = self._live
        try:
            rig.prepare(light.exposure_us, light.gain_db)
        except rigs.RigError as error:
            with self._lock:
                if live.light is light:
                    live.refusal = error_text(error)
                    live.light, live.paused = live.possible or light, live.possible is None
                    self._changed()
            if live.possible is None:
                raise
            live.possible = None
        else:
            live.possible = light

    def _keep(self, frame: LiveFrame, light: Light) -> None:
        """Show a frame, unless another light was requested meanwhile."""
        live = self._live
        with self._lock:
            self._trouble = ""
            live.number += 1
            if live.light is not light:
                return
            live.turn += 1
            if light.mode == "all" and light.leds:
                live.composite.add(frame)
                if live.turn % len(light.leds):
                    return
                frame, live.composite = live.composite.frame(frame), Composite()
            region = live.region
        figures = _figures(frame, region)
        now_s = time.monotonic()
        with self._lock:
            apart_s = now_s - live.taken_s
            live.rate_hz = 1 / apart_s if apart_s > 0 else 0.0
            live.frame, live.figures, live.taken_s = frame, figures, now_s
            self._changed()

    def _fail(self, error: rigs.RigError) -> None:
        """Report that the rig failed, also in the terminal."""
        trouble, self.confirmed_off = error_text(error), False
        if self._report(trouble):
            note(f"error: {trouble}")

    def _report(self, trouble: str) -> bool:
        """Show a trouble; return whether it is another one than before."""
        with self._lock:
            if self._trouble == trouble:
                return False
            self._trouble = trouble
            self._changed()
            return True

    def _rest(self, seconds: float) -> None:
        """Wait, but not after the end was requested."""
        ends_s = time.monotonic() + seconds
        while not self._closing and time.monotonic() < ends_s:
            time.sleep(_IDLE_S)

    # Called by any thread.

    @property
    def _attended(self) -> bool:
        return self._always_attended or time.monotonic() - self._seen_s < AWAY_S

    def _changed(self) -> None:
        self._changes += 1

    @property
    def changes(self) -> int:
        """Number of changes of the state so far."""
        return self._changes

    @property
    def closed(self) -> bool:
        """Whether the end was requested."""
        return self._closing

    def attend(self) -> None:
        """Note that an operator is there: without this for 10 s, nothing is lit."""
        self._seen_s = time.monotonic()

    def close(self) -> None:
        """Request the end: a task stops, and the rig is closed."""
        self._closing = True
        self.stop("the end of the screen")

    def light(self, light: Light) -> None:
        """Choose what lights the live picture.

        Raises
        ------
        ValueError
            If an LED does not exist or is listed as dead, or the exposure time is out of range.
        BusyError
            If the rig is not open.
        """
        with self._lock:
            config, info = self._open.config, self._open.camera.info
            for led in light.leds:
                if not 0 <= led < config.leds:
                    raise ValueError(
                        f"LED {led} does not exist: the rig has 0 to {config.leds - 1}"
                    )
                if led in config.dead_leds:
                    raise ValueError(f"LED {led} is listed as dead in the rig file")
            low, high = info.exposure_min_us, info.exposure_max_us
            if not low <= light.exposure_us <= high:
                raise ValueError(
                    f"the camera exposes for {low:g} to {high:g} us, not for {light.exposure_us:g}"
                )
            self._live.light, self._live.refusal = light, ""
            self._live.composite, self._live.turn = Composite(), 0
            self._live.paused = False
            self._changed()

    def look_at(self, region: Region | None) -> None:
        """Choose the region for the focus measure, None for the complete frame."""
        with self._lock:
            self._live.region = region

    def pause(self, paused: bool) -> None:
        """Stop or continue the live picture."""
        with self._lock:
            self._live.paused = paused
            self._changed()

    def request(self, name: str, task: Task) -> None:
        """Request a task.

        Raises
        ------
        BusyError
            If another one is running, or the rig is not open.
        """
        with self._lock:
            _ = self._open
            if self._task is not None:
                raise BusyError(f"{self._task[0]} is running: wait, or stop it first")
            self._stop = StopRequest()
            self._task = name, task
            self._changed()

    def stop(self, by: str) -> None:
        """End a task and the live picture at once, with all LEDs off."""
        self._live.paused = True
        self._end(by)

    def _end(self, by: str) -> None:
        """End the task or the exposure that is running."""
        with self._lock:
            stop = self._stop
            if self._task is not None:
                stop.ask(by)
            self._changed()
        ends_s = time.monotonic() + _STOPPING_S
        while True:
            with self._lock:
                self._cut = True
                if self._rig is not None:
                    self._rig.board.darken()
                running = self._shooting or (self._task is not None and self._stop is stop)
            if not running or time.monotonic() > ends_s:
                return
            time.sleep(_IDLE_S)

    @property
    def frame(self) -> LiveFrame | None:
        """The latest live frame."""
        return self._live.frame

    @property
    def white_dn(self) -> float:
        """White level of the latest live frame; the largest 16-bit value before the first."""
        return 65535.0 if self._live.frame is None else self._live.frame.white_dn

    @property
    def current_light(self) -> Light:
        """What lights the live picture."""
        return self._live.light

    def state(self) -> dict[str, Any]:
        """Return everything that a screen shows, in JSON types."""
        with self._lock:
            live = self._live
            return {
                "changes": self._changes,
                "rig": None if self._rig is None else _described(self._rig),
                "trouble": self._trouble or self._live.refusal,
                "task": None if self._task is None else self._task[0],
                "live": {
                    **asdict(live.light),
                    "paused": live.paused,
                    "rate_hz": live.rate_hz,
                    "frame": live.figures,
                },
                **self.desk.state(),
            }

    @property
    def _open(self) -> rigs.Rig:
        if self._rig is None:
            raise BusyError(f"the rig is not open: {self._trouble}")
        return self._rig


def _figures(frame: LiveFrame, region: Region | None) -> dict[str, Any]:
    quality = frame.quality(region)
    return {
        "number": frame.number,
        "leds": list(frame.leds),
        "size": list(frame.size),
        "exposure_us": frame.exposure_us,
        "gain_db": frame.gain_db,
        "clipped_fraction": frame.clipped_fraction,
        "sharpness": quality.sharpness,
        "histogram": frame.histogram.tolist(),
    }


def _described(rig: rigs.Rig) -> Mapping[str, Any]:
    config, info = rig.config, rig.camera.info
    return {
        "name": config.name,
        "leds": config.leds,
        "dead_leds": list(config.dead_leds),
        "positions_mm": [list(place) for place in config.led_positions_mm],
        "camera": f"{info.vendor} {info.model} {info.serial}",
        "size": list(config.mounting.upright_shape((info.height, info.width))),
        "exposure_us": [info.exposure_min_us, info.exposure_max_us],
        "white_dn": info.white_dn,
    }
