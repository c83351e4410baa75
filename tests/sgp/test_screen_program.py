"""``capture preview`` as a program: its end, its errors, and its terminal."""

from __future__ import annotations

import os
import re
import select
import signal
import socket
import stat
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from urllib.parse import urlsplit
from urllib.request import url2pathname

import pytest

from acquisition import Session
from tests.cases import cases
from tests.sgp.screen_rig import LitRig, Served, served, until
from tests.sgp.small_rig import CAPTURE, RIG
from tests.sgp.virtual_bench import Bench

pty = pytest.importorskip("pty")
termios = pytest.importorskip("termios")

INSIDE = RIG + 'camera = "inside"\nrealtime = false\n'
NO_CAMERA = 'name = "bench"\ndriver = "bench"\nleds = 6\n'
MISSING = "rig bench: the camera's GenTL producer is missing"
CLOSED = "the screen is closed, and all LEDs are off\n"
UNSURE = "the screen is closed; the rig did not answer: check that all LEDs are off\n"
PORT_S = 60.0


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text(INSIDE, encoding="utf-8")
    return path


class Program:
    """A running ``capture preview``, with its page."""

    def __init__(self, *words: object, cwd: Path) -> None:
        self._process = subprocess.Popen(
            [*CAPTURE, "preview", "--no-open", *map(str, words)],
            cwd=cwd,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"NUMBA_NUM_THREADS": "1"},
        )
        self.lines: list[str] = []
        stderr = self._process.stderr
        assert stderr is not None
        while not (line := stderr.readline()).startswith("page: "):
            assert line, self.lines
            self.lines.append(line)
        self.address = line.removeprefix("page: ").strip()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._process.kill()
        with self._process:  # waits, and closes the pipes
            pass

    @property
    def pid(self) -> int:
        return self._process.pid

    def page(self, out: Path) -> Served:
        """Return the page, without the station, which is in the other process."""
        return Served(None, None, None, self.address, out)  # type: ignore[arg-type]

    def end(self, number: int = signal.SIGINT) -> tuple[int, str, str]:
        """Send a signal, and return exit code, stdout and stderr after the address."""
        self._process.send_signal(number)
        out, err = self._process.communicate(timeout=60)
        assert "Traceback" not in err
        kept = [line for line in (*self.lines, *err.splitlines(True)) if "compiling" not in line]
        return self._process.returncode, out, "".join(kept)


def test_ctrl_c_without_a_task_is_the_usual_end(file: Path, tmp_path: Path) -> None:
    with Program("--rig", file, cwd=tmp_path) as program:
        with program.page(tmp_path).watched() as states:
            until(lambda: next(states)["live"]["frame"])
        assert program.end() == (0, CLOSED, "")


@pytest.mark.slow
def test_ctrl_c_ends_a_recording_which_is_resumed(file: Path, tmp_path: Path) -> None:
    plan = tmp_path / "plan.toml"
    plan.write_text('leds = "0-5"\nexposures_us = [5000]\nrepeats = 900\n')
    with Program("--rig", file, "--plan", plan, "--out", tmp_path, cwd=tmp_path) as program:
        page = program.page(tmp_path)
        with page.watched() as states:
            until(lambda: next(states)["rig"])
            assert page.do(do="record", object="owl", check=False) == (200, "")
            until(lambda: (next(states)["recording"] or {}).get("frames"))
            code, out, err = program.end()
    assert (code, out) == (130, "")
    *_, state, error = err.splitlines()
    assert re.search(r"owl: incomplete, \d+ frames? (is|are) intact, .*`capture resume ", state)
    assert error.startswith("error: stopped by Ctrl-C")
    session = Session.open(tmp_path / "owl")
    assert not session.complete
    assert session.events[-1].event == "interrupted"


@pytest.mark.slow
def test_sigterm_ends_it(file: Path, tmp_path: Path) -> None:
    with Program("--rig", file, cwd=tmp_path) as program:
        assert program.end(signal.SIGTERM) == (143, "", "error: stopped by SIGTERM\n")


@pytest.mark.slow
def test_a_rig_that_does_not_open_is_said_on_the_page_and_the_terminal(tmp_path: Path) -> None:
    file = tmp_path / "rig.toml"
    file.write_text(NO_CAMERA)
    with Program("--rig", file, cwd=tmp_path) as program:
        with program.page(tmp_path).watched() as states:
            until(lambda: next(states)["trouble"].startswith(MISSING))
            time.sleep(1.2)  # it tries again
            state = next(states)
            assert state["rig"] is None
        code, out, err = program.end()
    assert (code, out) == (0, UNSURE)
    (line,) = err.splitlines()
    assert line == f"error: {state['trouble']}"


def port_in_use() -> Iterator[int]:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        yield other.getsockname()[1]


used_port = pytest.fixture(port_in_use)


def test_a_port_in_use_is_an_error(sgp: Any, file: Path, used_port: int) -> None:
    answer = sgp("capture", "preview", "--rig", file, "--port", used_port, "--no-open")
    line = answer.error_line(2)
    assert f"--port {used_port}: cannot be used" in line


@cases(
    ("text", "code", "message"),
    {
        "an LED too many": ('leds = "0-6"\nexposures_us = [5000]', 4, "LED 6 does not exist"),
        "no plan": ("leds = ", 4, "is not TOML"),
    },
)
def test_a_plan_that_does_not_fit_is_an_error(
    sgp: Any, file: Path, tmp_path: Path, text: str, code: int, message: str
) -> None:
    (tmp_path / "plan.toml").write_text(text)
    answer = sgp("capture", "preview", "--rig", file, "--plan", tmp_path / "plan.toml", "--no-open")
    assert message in answer.error_line(code)


@cases(
    ("words", "message"),
    {
        "a plan that is missing": (("--plan", "none.toml"), "none.toml"),
        "no port": (("--port", "70000"), "70000"),
        "no size": (("--pixel-mm", "0"), "pixel-mm"),
        "no terminal": (("--terminal",), "--terminal needs a terminal"),
    },
)
def test_wrong_words_are_an_error(
    sgp: Any, file: Path, words: tuple[str, ...], message: str
) -> None:
    answer = sgp("capture", "preview", "--rig", file, "--no-open", *words)
    assert message in answer.error_line(2)


@pytest.mark.parametrize("missing", ["uvicorn", "starlette"])
def test_without_the_extra_a_line_names_it(
    sgp: Any, file: Path, monkeypatch: pytest.MonkeyPatch, missing: str
) -> None:
    for name in list(sys.modules):
        if name.partition(".")[0] == missing or name == "sgp.screen.server":
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, missing, None)
    line = sgp("capture", "preview", "--rig", file, "--no-open").error_line(2)
    assert "the extra `screen`" in line
    assert "surface-geometry-processing[screen]" in line


def test_an_error_of_the_server_ends_the_program_with_a_line(
    sgp: Any, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import uvicorn

    main_loop = uvicorn.Server.main_loop

    async def broken(server: uvicorn.Server) -> None:
        server.should_exit = True
        await main_loop(server)
        raise RuntimeError("boom")

    monkeypatch.setattr(uvicorn.Server, "main_loop", broken)
    answer = sgp("capture", "preview", "--rig", file, "--no-open")
    assert answer.code == 1
    page, error = answer.err.splitlines()
    assert page.startswith("page: ")
    assert error.startswith("error: RuntimeError: boom")
    assert error.endswith("; all LEDs are off")


def test_the_browser_opens_the_page(sgp: Any, file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []

    def browse(address: str) -> bool:
        link = Path(url2pathname(urlsplit(address).path))
        assert [stat.S_IMODE(path.stat().st_mode) for path in (link, link.parent)] == [0o600, 0o700]
        (page,) = re.findall(r'url=([^"]+)"', link.read_text())
        opened.extend([address, page, urllib.request.urlopen(page, timeout=30).read().decode()])
        threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGINT)).start()
        return True

    monkeypatch.setattr("webbrowser.open", browse)
    answer = sgp("capture", "preview", "--rig", file)
    link, page, text = opened
    assert "<title>Capture preview</title>" in text
    assert f"page: {page}" in answer.err
    # Other users see the address that the browser is started with.
    assert urlsplit(page).path.strip("/") not in link
    assert not Path(url2pathname(urlsplit(link).path)).parent.exists()
    assert (answer.code, answer.out) == (0, CLOSED)


@pytest.mark.parametrize("kind", ["a file", "below a file"])
def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path, kind: str) -> None:
    (tmp_path / "file").write_text("")
    rig = LitRig()
    out = tmp_path / "file" / "below" if kind == "below a file" else tmp_path / "file"
    with served(rig, out) as made:
        until(lambda: made.station.attend() or made.station.frame)
        code, error = made.do(do="record", object="owl", check=False)
        assert code == 422
        assert "file" in error
    rig.close()


def test_a_disk_that_is_nearly_full_is_said_before_the_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import shutil

    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=1000))
    rig = LitRig()
    with served(rig, tmp_path) as made:
        until(lambda: made.station.attend() or made.station.frame)
        made.do(do="check")
        disk, *_ = made.finished()["checks"]
        assert (disk["name"], disk["state"]) == ("disk", "failed")
        made.do(do="record", object="owl")
        state = made.finished()
        assert state["recording"]["state"] == "not begun"
        assert "disk" in state["failure"]
        assert len(rig.opened) == 1  # the rig is not broken
    rig.close()


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_program_that_ends_leaves_no_led_on(bench: Bench, tmp_path: Path, number: int) -> None:
    plan = tmp_path / "plan.toml"
    plan.write_text("leds = [7]\nexposures_us = [3000000]\n")
    program = Program("--rig", bench.rig, "--plan", plan, cwd=tmp_path)
    with program, program.page(tmp_path).watched():
        until(lambda: bench.state.led(time.monotonic_ns()) == 7)
        time.sleep(0.3)
        start_ns = time.monotonic_ns()
        os.kill(program.pid, number)
        until(bench.dark, 3.0)
        (period,) = (one for one in bench.state.periods() if one.end_ns > start_ns)
        assert period.led == 7
        # The board's watchdog acts after 0.9 s.
        assert period.end_ns - start_ns < 1.2e9
        time.sleep(1.0)
        assert bench.dark()


@pytest.mark.slow
def test_a_minute_of_live_pictures_needs_no_more_memory(file: Path, tmp_path: Path) -> None:
    file.write_text(RIG.replace("64", "512").replace("52", "400") + 'camera = "inside"\n')

    def resident_mb(program: Program) -> float:
        status = Path(f"/proc/{program.pid}/status").read_text()
        return int(status.partition("VmRSS:")[2].split()[0]) / 1024

    region = "left=0&top=0&width=512&height=400&columns=512&rows=400&clipped=1&peaking=1"
    with Program("--rig", file, cwd=tmp_path) as program:
        page = program.page(tmp_path)
        with page.watched() as states:
            found: list[float] = []
            ends_s = time.monotonic() + 60
            while time.monotonic() < ends_s:
                number = next(states)["live"]["frame"].get("number", 0)
                page.get(f"frame?after={number - 1}&{region}")
                found.append(resident_mb(program))
        code, _, _ = program.end()
    third = len(found) // 3
    assert code == 0
    assert max(found[-third:]) < max(found[third : 2 * third]) + 10


# The terminal.


class Terminal:
    """A ``capture preview --terminal`` on a terminal."""

    def __init__(self, file: Path, cwd: Path) -> None:
        self.text = ""
        self._master, self._slave = os.openpty()
        self.before = termios.tcgetattr(self._slave)
        self._process = subprocess.Popen(
            [*CAPTURE, "preview", "--rig", str(file), "--terminal"],
            cwd=cwd,
            stdin=self._slave,
            stdout=self._slave,
            stderr=self._slave,
            env=os.environ | {"NUMBA_NUM_THREADS": "1", "TERM": "xterm", "COLUMNS": "100"},
            preexec_fn=self._lead,
        )

    def _lead(self) -> None:
        import fcntl

        os.setsid()
        fcntl.ioctl(0, termios.TIOCSCTTY, 0)

    def _read(self, seconds: float = 0.1) -> bool:
        if not select.select([self._master], [], [], seconds)[0]:
            return False
        data = os.read(self._master, 65536).decode(errors="replace")
        self.text += re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", data)
        return True

    def until(self, shows: str) -> str:
        """Wait until the last lines show something, and return the last match."""
        ends_s = time.monotonic() + 60
        while not (found := re.findall(shows, self.text[-1500:])):
            assert time.monotonic() < ends_s, self.text[-3000:]
            assert self._process.poll() is None, self.text
            self._read()
        self.text = ""
        return str(found[-1])

    def press(self, keys: str) -> None:
        os.write(self._master, keys.encode())

    def end(self) -> tuple[int, str]:
        """Wait for the end, and return the exit code and what was written last."""
        ends_s = time.monotonic() + 60
        while self._process.poll() is None:
            assert time.monotonic() < ends_s
            self._read()
        while self._read():
            pass
        assert termios.tcgetattr(self._slave) == self.before
        os.close(self._master)
        os.close(self._slave)
        return self._process.returncode, self.text.replace("\r\n  ", " ")

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Callable[[Path], Terminal]]:
    opened: list[Terminal] = []

    def start(file: Path) -> Terminal:
        opened.append(Terminal(file, tmp_path))
        return opened[-1]

    yield start
    for one in opened:
        one.kill()


def test_keys_change_led_and_exposure(terminal: Callable[[Path], Terminal], file: Path) -> None:
    view = terminal(file)
    view.until(r"LED 0, 20 ms")
    view.press("\x1b[C")
    view.until(r"LED 1, 20 ms")
    view.press("\x1b[D\x1b[D")
    view.until(r"LED 5, 20 ms")
    view.press("+++")
    view.until(r"LED 5, 40(\.\d)? ms")
    view.press("-")
    view.until(r"LED 5, 31\.\d ms")
    view.press("o")
    view.until(r"all LEDs off, 31\.\d ms")
    view.press("n")
    view.until(r"LED 0, 31\.\d ms")
    assert int(view.until(r"focus +#* +(\d+)% of the best")) > 0
    view.until(r"histogram  .*[▁▂▃▄▅▆▇█]")
    view.press("-" * 60)
    view.until(r"the camera exposes for 10 to 1e\+07 us")
    view.press("xq")
    code, text = view.end()
    assert code == 0
    assert CLOSED.strip() in text
    assert "Traceback" not in text


@pytest.mark.slow
def test_after_ctrl_c_the_terminal_is_as_before(
    terminal: Callable[[Path], Terminal], file: Path
) -> None:
    view = terminal(file)
    view.until(r"LED 0, 20 ms")
    view.press("\x03")
    code, text = view.end()
    assert code == 0
    assert CLOSED.strip() in text


@pytest.mark.slow
def test_after_an_error_the_terminal_is_as_before(
    terminal: Callable[[Path], Terminal], tmp_path: Path
) -> None:
    file = tmp_path / "rig.toml"
    file.write_text(NO_CAMERA)
    view = terminal(file)
    view.until(MISSING)
    view.press("q")
    code, text = view.end()
    assert code == 0
    assert "Traceback" not in text


@pytest.mark.slow
def test_an_error_of_the_display_ends_the_program_with_a_line(
    terminal: Callable[[Path], Terminal],
    file: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # A module of the start of Python breaks the display.
    (tmp_path / "sitecustomize.py").write_text(
        "import sgp.screen.terminal_view as view\n"
        "def broken(*_):\n    raise RuntimeError('boom')\n"
        "view._bars = broken\n"
    )
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    view = terminal(file)
    code, text = view.end()
    assert code == 1
    assert "error: RuntimeError: boom" in text
    assert "all LEDs are off" in text
    assert "Traceback" not in text
