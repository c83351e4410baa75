"""Programs in processes that are forked from one with all imports done, so they start quickly."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

# A program ends as one that was started: it is run at the top of the main module. Objects that are
# there before are never looked at by its garbage collector, which would copy them.
_SERVER = """
import gc, json, os, socket, sys
import harvesters.core
import numpy
import acquisition.imports, acquisition.session, rig.genicam, rig.shooting
import simulator.bench, simulator.camera, simulator.led_board.firmware, simulator.led_board.outputs
from acquisition import NoiseModel, watch_folder
from rig.genicam.camera import open_genicam
control = socket.socket(fileno=int(sys.argv[1]))
gc.collect()
gc.freeze()
while True:
    request, fds, *_ = socket.recv_fds(control, 1 << 20, 3)
    if not request:
        os._exit(0)
    words = json.loads(request)
    if "program" in words:
        if not (reply := os.fork()):
            break
        for fd in fds:
            os.close(fd)
    else:
        pid, status = os.waitpid(words["pid"], os.WNOHANG)
        reply = os.waitstatus_to_exitcode(status) if pid else None
    control.send(json.dumps(reply).encode())
control.close()
if words["session"]:
    os.setsid()
os.chdir(words["folder"])
os.environ.clear()
os.environ.update(words["environment"])
for number, fd in enumerate(fds):
    os.dup2(fd, number)
    os.close(fd)
sys.argv = ["-c", *words["arguments"]]
exec(compile(words["program"], "<string>", "exec"), globals())
if words["session"]:
    # A board or camera that has done its work: what is left to end is the interpreter.
    sys.stdout.flush()
    os._exit(0)
"""


class ForkServer:
    """Forks programs from one process."""

    def __init__(self) -> None:
        self._control, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with other:
            command = [sys.executable, "-P", "-c", _SERVER, str(other.fileno())]
            self._process = subprocess.Popen(command, pass_fds=(other.fileno(),))

    def start(self, program: str, *arguments: object) -> Forked:
        """Start a program whose standard input, output and errors are pipes of text."""
        command = [sys.executable, "-c", program, *map(str, arguments)]
        return Forked(self, command, *3 * [subprocess.PIPE], text=True)

    def run(self, program: str, *arguments: object) -> Forked:
        """Run a program to its end; return it with its output and errors as `out` and `err`."""
        process = self.start(program, *arguments)
        process.communicate()
        process.end()
        return process

    @property
    def as_subprocess(self) -> SimpleNamespace:
        """A module `subprocess` for code that starts Python programs."""

        def popen(command: Sequence[str], *, start_new_session: bool, **files: Any) -> Forked:
            streams = [files.get(name) for name in ("stdin", "stdout", "stderr")]
            return Forked(self, command, *streams, session=start_new_session)

        return SimpleNamespace(**{**vars(subprocess), "Popen": popen})

    def ask(self, words: dict[str, Any], fds: Sequence[int] = ()) -> int | None:
        """Return the server's reply."""
        socket.send_fds(self._control, [json.dumps(words).encode()], fds)
        reply: int | None = json.loads(self._control.recv(100))
        return reply

    def close(self) -> None:
        self._control.close()
        self._process.wait(60)


class Forked:
    """A forked process, as `subprocess.Popen`."""

    def __init__(
        self,
        server: ForkServer,
        command: Sequence[str],
        *streams: int | None,
        session: bool = False,
        text: bool = False,
    ) -> None:
        program, *arguments = command[command.index("-c") + 1 :]
        self._server = server
        self.returncode: int | None = None
        self.out = self.err = ""
        theirs: list[int] = []
        ours: list[Any] = []
        for number, stream in enumerate(streams):
            if stream == subprocess.PIPE:
                ends = os.pipe()
                theirs.append(ends[number > 0])
                mode = ("r" if number else "w") + ("" if text else "b")
                ours.append(open(ends[number == 0], mode))  # noqa: SIM115 - closed by its owner
            else:
                theirs.append(os.open(os.devnull, os.O_RDWR) if stream else os.dup(number))
                ours.append(None)
        self.stdin, self.stdout, self.stderr = ours
        words = {
            "program": program,
            "arguments": arguments,
            "session": session,
            "folder": os.getcwd(),
            "environment": dict(os.environ),
        }
        pid = server.ask(words, theirs)
        assert pid is not None
        self.pid = pid
        for fd in theirs:
            os.close(fd)

    def poll(self) -> int | None:
        if self.returncode is None:
            self.returncode = self._server.ask({"pid": self.pid})
        return self.returncode

    def wait(self, timeout: float = 100) -> int:
        ends_s = time.monotonic() + timeout
        while (code := self.poll()) is None:
            if time.monotonic() > ends_s:
                raise subprocess.TimeoutExpired("a forked program", timeout)
            time.sleep(0.005)
        return code

    def communicate(self) -> tuple[str, str]:
        """Return what a program writes that writes little, and wait for its end."""
        self.stdin.close()
        self.wait()
        self.out, self.err = self.stdout.read(), self.stderr.read()
        return self.out, self.err

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)

    def end(self) -> None:
        """Kill it if it still runs, and close the pipes."""
        self.kill()
        self.wait()
        for pipe in (self.stdin, self.stdout, self.stderr):
            pipe.close()
