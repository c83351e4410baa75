"""A camera in a separate process, for GenTL producers that hang or crash.

Some producers never return once their camera was unplugged, or end the program. In a process of its
own, such a producer is ended with the process, and the camera can be opened again.
"""

from __future__ import annotations

import json
import queue
import subprocess
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from io import BufferedReader
from pathlib import Path
from typing import Any, cast

import numpy as np

from rig._errors import (
    CameraError,
    CameraGoneError,
    FrameLostError,
    FrameTimeoutError,
    closed_after_errors,
)
from rig.camera.interface import CameraFrame, CameraInfo, Trigger
from rig.processes.child import module_command

_KINDS = (CameraError, CameraGoneError, FrameLostError, FrameTimeoutError)
_ERRORS = {kind.__name__: kind for kind in _KINDS}
# Time for a call after which the producer counts as stuck; of a frame, in addition to its timeout.
_OPENING_S = 20.0
_CALL_S = 10.0
_FRAME_S = 2.0
_ENDING_S = 2.0
_WAITING_EVERY_S = 0.1


class IsolatedCamera:
    """A GenICam camera in a child process; as `rig.Camera`. Created by `open_isolated`.

    The child ends with this process, also if this one is killed. Ctrl-C does not end it.

    Parameters
    ----------
    options
        Arguments of `open_genicam`, as JSON has them.

    Attributes
    ----------
    info
        Identity and properties of the camera.
    pid
        Process id of the child.

    Raises
    ------
    CameraError
        As `open_genicam`.
    CameraGoneError
        By every method, if the process has ended or does not answer; it was ended then.
    """

    info: CameraInfo

    def __init__(self, options: dict[str, Any]) -> None:
        # In a separate session, Ctrl-C in the terminal does not reach it.
        self._process = subprocess.Popen(
            module_command("rig.genicam.isolated_process"),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        self.pid = self._process.pid
        self._name = str(options.get("serial") or options["cti"])
        self._number = 0
        self._closed = False
        self._gone = ""
        # None: the process has ended.
        self._replies: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        self._reader = threading.Thread(target=self._read, name="isolated camera", daemon=True)
        self._reader.start()
        with closed_after_errors(self.close):
            self._ask("open", options, _OPENING_S)
        self._name = self.info.serial or self.info.model

    def configure(self, *, exposure_us: float, gain_db: float = 0.0) -> float:
        """Set exposure time and gain, armed or not, and return the exposure time as read back."""
        return float(self._ask("configure", {"exposure_us": exposure_us, "gain_db": gain_db}))

    def arm(self, trigger: Trigger = "software", frames: int = 1) -> None:
        """Prepare for triggers of one kind. Frames of earlier triggers are discarded."""
        self._ask("arm", {"trigger": trigger, "frames": frames})

    def trigger(self) -> int:
        """Start one exposure by software and return at once the id that its frame will have."""
        return int(self._ask("trigger"))

    def expect(self) -> int:
        """Announce one pulse on the trigger line and return the id that its frame must have."""
        return int(self._ask("expect"))

    def fetch(
        self, frame_id: int, timeout_s: float, waiting: Callable[[], None] | None = None
    ) -> CameraFrame:
        """Wait for the frame with this id; older frames that arrive late are discarded."""
        words = {"frame_id": frame_id, "timeout_s": timeout_s}
        called = waiting or (lambda: None)
        try:
            return CameraFrame(**self._ask("fetch", words, timeout_s + _FRAME_S, called))
        except BaseException:
            self._send("cancel", {})
            raise

    def disarm(self) -> None:
        """Stop accepting triggers."""
        self._ask("disarm")

    def close(self) -> None:
        """Release the camera and end its process; closing twice does nothing."""
        if self._closed:
            return
        try:
            # If it is gone, ending its process is enough.
            with suppress(CameraGoneError):
                if hasattr(self, "info"):
                    self._ask("close")
        finally:
            self._closed = True
            self._end(_ENDING_S)

    def _ask(
        self,
        call: str,
        words: dict[str, Any] | None = None,
        timeout_s: float | None = None,
        waiting: Callable[[], None] = lambda: None,
    ) -> Any:
        """Let the process carry out a call; return its result, or raise its error."""
        if self._closed:
            raise CameraError(f"camera {self._name} is closed")
        self._check_there()
        self._number += 1
        self._send(call, words or {})
        limit_s = _CALL_S if timeout_s is None else timeout_s
        reply = self._reply(time.monotonic() + limit_s, waiting)
        if "error" not in reply:
            return reply["result"]
        kind, message, counts = reply["error"]
        if kind not in _ERRORS:
            raise CameraError(f"camera {self._name}, {call}: {kind}: {message}")
        error = _ERRORS[kind]
        raise error(message, counts) if issubclass(error, FrameLostError) else error(message)

    def _reply(self, ends_s: float, waiting: Callable[[], None]) -> dict[str, Any]:
        """Wait for the reply to the last request."""
        while True:
            try:
                reply = self._replies.get(timeout=_WAITING_EVERY_S)
            except queue.Empty:
                if time.monotonic() >= ends_s:
                    self._end(0)
                    self._gone = "its GenTL producer is stuck, so its process was ended"
                    self._check_there()
                waiting()
                continue
            if reply is None:
                self._end(_ENDING_S)
                self._gone = f"the process of its GenTL producer ended ({self._process.returncode})"
                self._check_there()
            # Replies to calls that were interrupted may still arrive.
            elif reply["number"] == self._number:
                return reply

    def _check_there(self) -> None:
        if self._gone:
            raise CameraGoneError(
                f"camera {self._name} no longer answers: {self._gone}; check its cable and power"
            )

    def _send(self, call: str, words: dict[str, Any]) -> None:
        request = {"number": self._number, "call": call, "words": words}
        # If the process has ended, this is noticed when its reply is awaited.
        with suppress(OSError, ValueError):
            if self._process.stdin is not None:
                self._process.stdin.write(json.dumps(request).encode() + b"\n")
                self._process.stdin.flush()

    def _read(self) -> None:
        """Read the replies, on a separate thread, until the process has ended."""
        out = cast(BufferedReader, self._process.stdout)
        while line := out.readline():
            reply = json.loads(line)
            if "info" in reply:
                said = reply["info"]
                self.info = CameraInfo(**{**said, "turned_off": tuple(said["turned_off"])})
            result = reply.get("result")
            if isinstance(result, dict):
                shape = result.pop("shape")
                pixels = np.zeros(shape, np.uint16)
                if out.readinto(pixels.data) != pixels.nbytes:
                    break
                result["pixels"] = pixels
            self._replies.put(reply)
        self._replies.put(None)

    def _end(self, patience_s: float) -> None:
        """End the process; first wait for so long, since it ends when its input is closed."""
        process = self._process
        with suppress(OSError):
            if process.stdin is not None:
                process.stdin.close()
        try:
            process.wait(patience_s)
        except subprocess.TimeoutExpired:
            process.kill()
            with suppress(subprocess.TimeoutExpired):  # a driver may keep it
                process.wait(_ENDING_S)
        self._reader.join(_ENDING_S)
        if process.stdout is not None:
            process.stdout.close()


def open_isolated(cti: str | Path, **options: Any) -> IsolatedCamera:
    """Open the camera that a GenTL producer offers, in a separate process.

    Parameters
    ----------
    cti
        The producer (.cti file).
    options
        As for `open_genicam`.

    Raises
    ------
    CameraError
        As `open_genicam`, or if the process does not start.
    """
    return IsolatedCamera({"cti": str(Path(cti).absolute()), **options})
