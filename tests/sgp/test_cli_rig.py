"""``sgp rig``: reports about a working bench, and one clear line for each fault."""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
import tty
from pathlib import Path

import numpy as np
import pytest

import rig._board.ports
from acquisition import NoiseModel, read_image
from rig import Board, Command, LineError, Reply, decode_command, encode_reply
from simulator import VirtualBoard
from simulator._bench_state import BenchState
from simulator._board.faults import BoardFault
from simulator._camera.gentl_camera import GentlCamera
from tests.quick_sample import quick
from tests.simulator.camera_options import grouped

SIZE = (24, 32)
NOISE = NoiseModel(10.0, 0.0, 64.0, 12)


def plane(led):
    return np.full(SIZE, 0.0 if led is None else led + 1, np.float32)


class Bench:
    """A virtual board and a virtual GenICam camera, as a rig file of the driver ``bench``."""

    def __init__(self, folder: Path, leds: int = 36) -> None:
        self.board = VirtualBoard(leds)
        self.state = BenchState(self.board.bench_state_path)
        self.options = {"port": self.board.port}
        self.keys = {}
        self.file = folder / "rig.toml"
        self._camera = None

    def camera(self, **options):
        self._camera = GentlCamera(
            plane,
            **grouped(
                **{
                    "size": SIZE,
                    "leds": 36,
                    "noise": NOISE,
                    "noisy": False,
                    "serial": "cam-7",
                    "bench_state_path": self.board.bench_state_path,
                    **options,
                }
            ),
        )
        self.options["cti"] = str(self._camera.cti)
        return self._camera

    @property
    def rig(self) -> Path:
        if self._camera is None and "cti" not in self.options:
            self.camera()
        keys = {"name": "bench 1", "driver": "bench", "frame_timeout_s": 0.3, **self.keys}
        tables = ((keys, ""), (self.options, "[options]\n"))
        lines = (
            head + "".join(f"{key} = {json.dumps(value)}\n" for key, value in table.items())
            for table, head in tables
        )
        self.file.write_text("".join(lines))
        return self.file

    def dark(self) -> bool:
        return self.state.led(time.monotonic_ns()) is None

    def close(self) -> None:
        self.state.close()
        self.board.close()
        if self._camera is not None:
            self._camera.close()


@pytest.fixture
def bench(tmp_path):
    bench = Bench(tmp_path)
    yield bench
    bench.close()


@contextlib.contextmanager
def device(answer):
    """A serial device of another kind: ``answer`` maps received bytes to sent bytes."""
    master, slave = os.openpty()
    tty.setraw(slave)
    stop = threading.Event()

    def talk():
        os.set_blocking(master, False)
        while not stop.wait(0.01):
            with contextlib.suppress(OSError):
                os.write(master, answer(os.read(master, 4096)))

    thread = threading.Thread(target=talk)
    thread.start()
    try:
        yield os.ttyname(slave)
    finally:
        stop.set()
        thread.join()
        os.close(master)
        os.close(slave)


def of_protocol_1(heard: bytes) -> bytes:
    replies = b""
    for line in heard.splitlines():
        with contextlib.suppress(LineError):
            command: Command = decode_command(line)
            words = ("sgp-led-board", "1", "1.0.0", "36", "10000")
            replies += encode_reply(Reply(command.seq, command.verb, words))
    return replies


def test_a_working_bench_is_described(bench, sgp):
    answer = sgp("rig", "check", "--rig", bench.rig, "--json")
    assert answer.code == 0, answer.err
    report = json.loads(answer.out)["metrics"]
    assert (report["board"]["leds"], report["board"]["port"]) == (36, bench.board.port)
    assert (report["camera"]["serial"], report["camera"]["pixel_format"]) == ("cam-7", "Mono12")
    plain = sgp("rig", "check", "--rig", bench.rig)
    assert "bench 1, 36 LEDs" in plain.out
    assert "the self-test cannot detect swapped LEDs" in plain.err


def test_check_warns_of_problems_that_are_not_errors_yet(bench, sgp):
    board = Board(bench.board.port)
    board._line._serial.write(b">0000 ON 1 1000*FFFF\n")
    board.on(3, 50_000)
    time.sleep(1.4)
    board.close()
    answer = sgp("rig", "check", "--rig", bench.rig)
    assert answer.code == 0
    assert "received 1 damaged line since" in answer.err
    assert "watchdog turned LEDs off 1 time since" in answer.err


def test_check_says_how_the_camera_is_mounted(sgp, tmp_path):
    file = tmp_path / "rig.toml"
    file.write_text(
        'name = "x"\ndriver = "simulated"\nleds = 4\n'
        "[mounting]\nrotation_deg = 90\nmirror = true\n[options]\nwidth = 64\nheight = 48\n"
    )
    answer = sgp("rig", "check", "--rig", file)
    assert "mirrored and rotated by 90 degrees to be upright" in answer.out
    assert "48 x 64 Mono12" in answer.out


def test_list_names_rigs_ports_and_cameras(bench, sgp, tmp_path):
    bench.camera()
    with device(lambda heard: heard) as echo:
        ports = ["--port", bench.board.port, "--port", echo, "--port", tmp_path / "none"]
        answer = sgp("rig", "list", *ports, "--cti", bench.options["cti"], "--json")
    assert answer.code == 0, answer.err
    report = json.loads(answer.out)["metrics"]
    assert {"bench", "simulated"} <= set(report["rigs"])
    assert [port["board"] is not None for port in report["ports"]] == [True, False, False]
    assert "cannot be opened" in report["ports"][2]["complaint"]
    assert [camera["serial"] for camera in report["cameras"]] == ["cam-7"]


def test_an_empty_list_says_what_to_do(sgp, monkeypatch):
    monkeypatch.setattr(rig._board.ports.list_ports, "comports", list)
    answer = sgp("rig", "list")
    assert answer.code == 0
    assert "no LED board was found" in answer.out
    assert "--cti" in answer.out


def test_a_missing_producer_is_reported_before_any_port_is_opened(sgp, monkeypatch, tmp_path):
    asked = []
    monkeypatch.setattr(rig._board.ports.list_ports, "comports", lambda: asked.append(1) or [])
    answer = sgp("rig", "list", "--cti", tmp_path / "missing.cti")
    assert "missing.cti: no such file" in answer.error_line(2)
    assert not asked


def test_a_port_without_a_board_is_listed_as_a_port(sgp, tmp_path):
    answer = sgp("rig", "list", "--port", tmp_path / "none")
    assert answer.code == 0
    assert f"\nport     {tmp_path / 'none'}: the port cannot be opened" in answer.out


def test_the_rig_without_a_file_is_not_asked_to_change_one(sgp):
    answer = sgp("rig", "selftest", "--rig", "simulated")
    assert answer.code == 0
    assert "rig file" not in answer.err


def test_a_frame_is_snapped_as_the_sensor_gave_it(bench, sgp, tmp_path):
    out = tmp_path / "frame.tif"
    words = ["rig", "snap", "--led", 4, "--exposure-us", 2000, "--out", out, "--rig", bench.rig]
    answer = sgp(*words)
    assert answer.code == 0, answer.err
    assert bench.dark()
    # 5 electrons per us for 2000 us at 10 electrons per DN, plus the black level.
    assert (read_image(out) == 64 + 1000).all()
    view = read_image(out.with_suffix(".png"))
    assert view.dtype == np.uint8
    assert (view == round(255 * (1064 / 4095) ** (1 / 2.2))).all()
    assert "frame.png" in answer.out


def test_the_view_of_a_frame_is_upright_and_in_a_new_folder(sgp, tmp_path):
    rig = tmp_path / "rig.toml"
    rig.write_text(
        'name = "x"\ndriver = "simulated"\nleds = 4\n'
        "[mounting]\nrotation_deg = 90\nmirror = true\n[options]\nwidth = 64\nheight = 48\n"
    )
    out = tmp_path / "new" / "folder" / "frame.tif"
    words = ("rig", "snap", "--led", 1, "--out", out, "--rig", rig)
    answer = sgp(*words, "--json")
    assert answer.code == 0, answer.err
    raw, view = read_image(out), read_image(out.with_suffix(".png"))
    assert json.loads(answer.out)["outputs"]["view"] == str(out.with_suffix(".png"))
    assert (raw.shape, view.shape) == ((64, 48), (48, 64))
    # Mirrored left to right, then turned clockwise.
    upright = np.rot90(raw[:, ::-1], -1)
    assert (view == np.rint(255 * (upright / 4095) ** (1 / 2.2))).all()
    out.unlink()
    assert "frame.png already exists" in sgp(*words).error_line(2)
    assert not out.exists()


def test_off_turns_off_an_led_that_another_program_left_on(bench, sgp):
    board = Board(bench.board.port)
    board.on(3, 50_000)
    board.close()
    assert sgp("rig", "off", "--rig", bench.rig).code == 0
    assert bench.dark()


@pytest.fixture
def without_camera(bench):
    bench.options["cti"] = "/nowhere/maker.cti"
    return bench


def test_lights_need_no_camera(without_camera, sgp):
    bench = without_camera
    board = Board(bench.board.port)
    board.on(3, 50_000)
    board.close()
    assert sgp("rig", "off", "--rig", bench.rig).code == 0
    assert bench.dark()
    answer = sgp("rig", "light", 5, "--seconds", 0.2, "--rig", bench.rig)
    assert answer.code == 0, answer.err
    assert (bench.state.periods()[-1].led, bench.dark()) == (5, True)
    assert "maker.cti" in sgp("rig", "check", "--rig", bench.rig).error_line(3)


def test_first_light_needs_no_rig_file(bench, sgp, monkeypatch):
    class Port:
        device = bench.board.port

    monkeypatch.setattr(rig._board.ports.list_ports, "comports", lambda: [Port])
    assert sgp("rig", "light", 0, "--seconds", 0.2, "--rig", "bench").code == 0
    assert bench.state.periods()[-1].led == 0
    assert bench.dark()


def test_an_led_that_turns_off_by_itself_is_reported(without_camera, sgp):
    bench = without_camera
    bench.board.set_faults(BoardFault(kind="goes-dark", verb="ON", value=100))
    line = sgp("rig", "light", 5, "--seconds", 0.6, "--rig", bench.rig).error_line(3)
    assert "LED 5 was turned on, but no LED was on at the end" in line


def test_light_of_another_board_is_refused_in_the_dark(tmp_path, sgp):
    bench = Bench(tmp_path, leds=24)
    try:
        bench.options["cti"] = "/nowhere/maker.cti"
        line = sgp("rig", "light", 5, "--rig", bench.rig).error_line(3)
        assert "has 24 LEDs, but rig bench 1 is configured with 36" in line
        Board(bench.board.port).close()
    finally:
        bench.close()


def test_light_stays_on_for_longer_than_the_watchdog_time(bench, sgp):
    answer = sgp("rig", "light", 5, "--seconds", 1.6, "--rig", bench.rig)
    assert answer.code == 0, answer.err
    assert bench.dark()
    lit = bench.state.periods()[-1]
    assert lit.led == 5
    assert lit.end_ns - lit.start_ns >= 1_600_000_000 * 0.98


def test_ctrl_c_turns_the_light_off(bench):
    program = [sys.executable, "-c", "import sgp; sgp.main()", "rig", "light", "5"]
    host = subprocess.Popen(
        [*program, "--seconds", "30", "--rig", str(bench.rig)],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
    )
    ends = time.monotonic() + 30
    while bench.dark():
        assert time.monotonic() < ends
        assert host.poll() is None
        time.sleep(0.02)
    host.send_signal(signal.SIGINT)
    _, err = host.communicate(timeout=20)
    assert host.returncode == 130
    assert b"stopped by Ctrl-C" in err
    assert bench.dark()


def no_port(bench):
    bench.options["port"] = "/dev/no-such-port"


def busy(bench):
    return contextlib.closing(Board(bench.board.port))


@contextlib.contextmanager
def another_device(bench, answer):
    with device(answer) as port:
        bench.options["port"] = port
        yield


def echo(bench):
    return another_device(bench, lambda heard: heard)


def silent(bench):
    return another_device(bench, lambda heard: b"")


def protocol_1(bench):
    return another_device(bench, of_protocol_1)


def other_board(bench):
    bench.options["board"] = "led-dome-3"


def missing_cti(bench):
    bench.options["cti"] = str(bench.file.parent / "maker.cti")


def corrupt_cti(bench):
    path = bench.file.parent / "maker.cti"
    path.write_text("this is not a library")
    bench.options["cti"] = str(path)


def cut_cti(bench):
    made = bench.camera()
    path = bench.file.parent / "maker.cti"
    path.write_bytes(made.cti.read_bytes()[:4000])
    bench.options["cti"] = str(path)


def no_node(bench):
    bench.camera(without_nodes=("ExposureTime",))


def other_camera(bench):
    bench.camera()
    bench.options["camera"] = "cam-8"


def no_such_line(bench):
    bench.camera()
    bench.options["trigger_line"] = "Line9"
    bench.keys["trigger"] = "board"


def not_wired(bench):
    bench.camera(bench_state_path=None)
    bench.keys["trigger"] = "board"


def active_not_wired(bench):
    bench.camera(bench_state_path=None)
    bench.keys |= {"trigger": "board", "exposure_active": True}


def no_cti(bench):
    bench.options["cti"] = ""


def misspelt(bench):
    bench.options["prot"] = "auto"


SNAP = ["rig", "snap", "--led", "4", "--exposure-us", "5000", "--out", "frame.tif"]


@pytest.mark.parametrize(
    ("spoil", "words", "message"),
    quick(
        [
            pytest.param(
                no_port, SNAP, "/dev/no-such-port: the port cannot be opened", id="no port"
            ),
            pytest.param(
                busy, SNAP, "cannot be opened .* no other program uses it", id="port busy"
            ),
            pytest.param(echo, SNAP, "no answer within .* is the LED board", id="not our device"),
            pytest.param(silent, SNAP, "no answer within", id="silent device"),
            pytest.param(protocol_1, SNAP, "protocol 1, but this software speaks 2", id="protocol"),
            pytest.param(
                other_board, SNAP, "is sgp-virtual-board, .* requires led-dome-3", id="board"
            ),
            pytest.param(missing_cti, SNAP, r"maker\.cti", id="missing cti"),
            pytest.param(corrupt_cti, SNAP, r"maker\.cti", id="corrupt cti"),
            pytest.param(cut_cti, SNAP, r"maker\.cti", id="cti cut off"),
            pytest.param(no_node, SNAP, "cam-7 .*lacks nodes: ExposureTime", id="no exposure node"),
            pytest.param(other_camera, SNAP, "cam-8.* cam-7", id="another camera"),
            pytest.param(no_such_line, SNAP, "Line9", id="no such line"),
            pytest.param(
                not_wired, SNAP, "Line0.* frame 0 .*LED 4: check the wire", id="trigger not wired"
            ),
            pytest.param(
                active_not_wired, SNAP, "LED 4: the camera's exposure-active", id="active not wired"
            ),
            pytest.param(
                lambda bench: None,
                [*SNAP[:5], "0.5", *SNAP[6:]],
                "ExposureTime: 0.5 us is outside .* 10 to",
                id="exposure too short",
            ),
            pytest.param(
                lambda bench: None,
                [*SNAP[:5], "20000000", *SNAP[6:]],
                "ExposureTime: 2e.07 us is outside .* to 1e.07 us",
                id="exposure too long",
            ),
            pytest.param(no_cti, SNAP, "option 'cti'", id="no cti"),
            pytest.param(misspelt, SNAP, "unknown option 'prot'; known are", id="misspelt option"),
        ],
        every=3,
    ),
)
def test_a_faulty_bench_gets_one_line(bench, sgp, spoil, words, message, monkeypatch):
    monkeypatch.chdir(bench.file.parent)
    with spoil(bench) or contextlib.nullcontext():
        line = sgp(*words, "--rig", bench.rig).error_line(3)
    assert re.search(message, line), line
    assert bench.dark()
    assert not (bench.file.parent / "frame.tif").exists()


def test_a_board_of_24_leds_for_a_rig_of_36(tmp_path, sgp):
    bench = Bench(tmp_path, leds=24)
    try:
        line = sgp("rig", "check", "--rig", bench.rig).error_line(3)
        assert "has 24 LEDs, but rig bench 1 is configured with 36" in line
    finally:
        bench.close()


def test_no_board_at_any_port(bench, sgp, monkeypatch):
    monkeypatch.setattr(rig._board.ports.list_ports, "comports", list)
    bench.options["port"] = "auto"
    assert "no LED board" in sgp("rig", "off", "--rig", bench.rig).error_line(3)


def test_the_board_is_found_by_itself(bench, sgp, monkeypatch):
    class Port:
        device = bench.board.port

    monkeypatch.setattr(rig._board.ports.list_ports, "comports", lambda: [Port])
    bench.options["port"] = "auto"
    assert sgp("rig", "off", "--rig", bench.rig).code == 0


def test_the_bench_without_a_rig_file_says_what_to_write(sgp):
    assert "under [options], cti" in sgp("rig", "check", "--rig", "bench").error_line(3)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        pytest.param(["light", "36"], "LED 36 does not exist", id="no such LED"),
        pytest.param(["light", "3"], "LED 3 of bench 1 is listed as dead", id="dead LED"),
        pytest.param(
            ["light", "1", "--seconds", "100"], "keeps an LED on for at most 60 s", id="too long"
        ),
        pytest.param(["snap", "--led", "36", "--out", "f.tif"], "LED 36 does not", id="snap"),
    ],
)
def test_wrong_arguments_are_exit_2(bench, sgp, words, message, monkeypatch):
    monkeypatch.chdir(bench.file.parent)
    bench.keys["dead_leds"] = [3]
    assert message in sgp("rig", *words, "--rig", bench.rig).error_line(2)
    assert bench.dark()


SIMULATED = """
name = "dome"
driver = "simulated"
leds = 12
[options]
width = 160
height = 128
scene = "plane"
{wiring}
"""


@pytest.mark.parametrize(
    ("wiring", "code", "message"),
    [
        pytest.param("", 0, "no faults", id="in order", marks=pytest.mark.slow),
        pytest.param(
            "wiring = {swapped = [[3, 7]]}",
            3,
            "the light of LED 3 is from the place of LED 7",
            id="swapped",
        ),
        pytest.param("lamps = {dead = [5]}", 3, "1 fault", id="dead", marks=pytest.mark.slow),
    ],
)
def test_the_self_test_reports_its_findings(sgp, tmp_path, wiring, code, message):
    file = tmp_path / "rig.toml"
    file.write_text(SIMULATED.format(wiring=wiring))
    answer = sgp("rig", "selftest", "--rig", file)
    assert answer.code == code, answer.err
    assert message in answer.out
    report = json.loads(sgp("rig", "selftest", "--rig", file, "--json").out)
    assert report["ok"] == (code == 0)
    assert report["metrics"]["wires"] == {"trigger": True, "exposure_active": True}
    assert bool([one for one in report["metrics"]["findings"] if one["fault"]]) == (code != 0)


def test_the_self_test_says_if_swaps_cannot_be_excluded(sgp, tmp_path):
    """With eight LEDs this swap pulls the fit, so that no LED can be named."""
    file = tmp_path / "rig.toml"
    text = SIMULATED.format(wiring="wiring = {swapped = [[0, 1]]}")
    file.write_text(text.replace("12", "8", 1).replace("plane", "coin"))
    answer = sgp("rig", "selftest", "--rig", file)
    assert answer.code == 0, answer.err
    assert "no faults found, but swapped LEDs could not be excluded" in answer.out
    assert "a swap of these or of other LEDs would not be noticed" in answer.err
