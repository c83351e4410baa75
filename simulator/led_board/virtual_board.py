"""Start and end the virtual board's process."""

from __future__ import annotations

import contextlib
import json
import select
import shutil
import subprocess
from pathlib import Path

from rig import RigError
from rig.processes import module_command
from simulator.led_board.faults import BoardFault, faults_to_json

_START_TIMEOUT_S = 30.0
_END_TIMEOUT_S = 1.0


class VirtualBoard(contextlib.AbstractContextManager["VirtualBoard"]):
    """Virtual LED board that runs in its own process.

    Parameters
    ----------
    leds
        Number of LEDs.

    Attributes
    ----------
    port
        Path of its serial port, a symbolic link.
    bench_state_path
        File with the state of light and trigger line (see `BenchState`).
    pid
        Process id.

    Raises
    ------
    RigError
        If the process does not start.
    """

    def __init__(self, leds: int = 36) -> None:
        # In a new session, Ctrl-C reaches only the host, which still needs the board then.
        self._process = subprocess.Popen(
            module_command("simulator.board", leds),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )
        self.pid = self._process.pid
        try:
            paths = json.loads(self._first_line())
            self.port: str = paths["port"]
            self.bench_state_path = Path(paths["bench_state"])
        except BaseException:
            self._end()
            raise

    def set_faults(self, *faults: BoardFault) -> None:
        """Replace the faults; the new ones apply to the commands sent from now on."""
        if self._process.stdin is None:
            raise RigError("the virtual board is closed")
        try:
            self._process.stdin.write(faults_to_json(faults) + b"\n")
            self._process.stdin.flush()
        except (OSError, ValueError) as error:
            raise RigError(f"the virtual board's process has ended ({error})") from error

    def unplug(self) -> None:
        """Kill the process: the port is dead, an LED stays on until its declared end."""
        self._process.kill()
        self._process.wait()

    def close(self) -> None:
        """End the process and remove its bench state; closing twice does nothing."""
        self._end()
        shutil.rmtree(self.bench_state_path.parent, ignore_errors=True)

    def __exit__(self, *_: object) -> None:
        self.close()

    def _first_line(self) -> bytes:
        stdout, stderr = self._process.stdout, self._process.stderr
        if stdout is None or stderr is None:
            raise RigError("the virtual board has no pipes")
        ready, _, _ = select.select([stdout], [], [], _START_TIMEOUT_S)
        line = stdout.readline() if ready else b""
        if not line:
            self._process.kill()
            reason = stderr.read().decode(errors="replace").strip().splitlines()[-1:]
            raise RigError(f"the virtual board did not start: {' '.join(reason) or 'no answer'}")
        return line

    def _end(self) -> None:
        # The process ends when its standard input closes.
        if self._process.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self._process.stdin.close()
        try:
            self._process.wait(_END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        for pipe in (self._process.stdout, self._process.stderr):
            if pipe is not None:
                pipe.close()
