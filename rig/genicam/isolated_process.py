"""The process of an `IsolatedCamera`: a GenICam camera that is operated through pipes.

Each line of standard input is a request, a JSON object: ``number``, ``call`` (``open`` or a method
of the camera) and ``words``, its arguments. Each reply on standard output is a line with the same
``number``, and the ``result``, or an ``error``: class, message and counters. A reply may have
``info``, the new `CameraInfo`, and ``bytes``, the length of the pixels that follow the line. A
request ``cancel`` ends the ``fetch`` with its number.
"""

from __future__ import annotations

import faulthandler
import json
import os
import queue
import signal
import sys
import threading
import time
from contextlib import suppress
from dataclasses import asdict
from typing import Any, BinaryIO

from rig._errors import CameraError
from rig.camera.interface import Camera, CameraFrame

# A library that holds the interpreter's lock for so long will not return.
_STUCK_S = 30.0
# Time to close the camera when the parent has died.
_CLOSING_S = 5.0


class _CancelledError(Exception):
    """The parent no longer waits for the frame."""


class _Process:
    """Carries out requests on the main thread, one after the other."""

    def __init__(self, requests: BinaryIO, replies: BinaryIO) -> None:
        self._replies = replies
        self._requests = requests
        self._waiting: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        self._cancelled = -1
        self._camera: Camera | None = None
        self._info: dict[str, Any] = {}

    def run(self) -> None:
        """Work until the camera is closed, or the parent has died."""
        threading.Thread(target=self._read, daemon=True).start()
        while (request := self._waiting.get()) is not None:
            reply, pixels = self._reply(request)
            # The parent may have died.
            with suppress(BrokenPipeError):
                self._replies.write(json.dumps(reply).encode() + b"\n" + pixels)
                self._replies.flush()
            if request["call"] == "close":
                return
        if self._camera is not None:
            with suppress(CameraError):
                self._camera.close()

    def _read(self) -> None:
        for line in self._requests:
            request = json.loads(line)
            if request["call"] == "cancel":
                self._cancelled = request["number"]
            else:
                self._waiting.put(request)
        # The pipe is closed: the parent has died.
        self._cancelled = sys.maxsize
        self._waiting.put(None)
        time.sleep(_CLOSING_S)
        os._exit(1)

    def _reply(self, request: dict[str, Any]) -> tuple[dict[str, Any], memoryview]:
        number, call, words = request["number"], request["call"], request["words"]
        reply: dict[str, Any] = {"number": number}
        pixels = memoryview(b"")
        try:
            result = self._carry_out(number, call, words)
        except Exception as error:  # noqa: BLE001 - raised again in the parent
            counts = getattr(error, "counts", {})
            reply["error"] = [type(error).__name__, str(error), counts]
        else:
            if isinstance(result, CameraFrame):
                frame = dict(vars(result))
                data = frame.pop("pixels")
                pixels = memoryview(data).cast("B")
                result = {**frame, "shape": data.shape}
            reply |= {"result": result, "bytes": len(pixels)}
        info = {} if self._camera is None else asdict(self._camera.info)
        if info != self._info:
            self._info = reply["info"] = info
        return reply, pixels

    def _carry_out(self, number: int, call: str, words: dict[str, Any]) -> Any:
        if call == "open":
            from rig.genicam.camera import open_genicam

            self._camera = open_genicam(**words)
            return None
        if call == "fetch":
            words["waiting"] = lambda: self._check_wanted(number)
        return getattr(self._camera, call)(**words)

    def _check_wanted(self, number: int) -> None:
        if self._cancelled >= number:
            raise _CancelledError


def end_if_stuck(seconds: float = _STUCK_S) -> None:
    """End this process when no Python code has run for so long, even if a library never returns."""
    silent = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - until the process ends

    def live() -> None:
        while True:
            # Its own thread, which needs no lock of the interpreter, ends the process.
            faulthandler.dump_traceback_later(seconds, exit=True, file=silent)
            time.sleep(seconds / 10)

    threading.Thread(target=live, daemon=True).start()


def main() -> None:
    """Serve the parent."""
    # Ctrl-C is meant for the parent, which still needs the camera to finish its shot.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_if_stuck()
    replies = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    # What libraries print must not be among the replies.
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    _Process(sys.stdin.buffer, replies).run()
    # The camera is closed. Libraries need not be unloaded, which some of them survive badly.
    os._exit(0)


if __name__ == "__main__":
    main()
