"""``sgp rig``: reports about a working bench, and one clear line for each fault."""

import json
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import rig.board.ports
from acquisition import read_image
from rig import Board
from simulator.led_board import BoardFault
from tests.sgp.virtual_bench import device


def test_a_working_bench_is_described(bench, sgp):
    report = sgp("rig", "check", "--rig", bench.rig, "--json").figures()
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
    answer = sgp("rig", "check", "--rig", bench.rig).ok()
    assert "received 1 damaged line since" in answer.err
    assert "watchdog turned LEDs off 1 time since" in answer.err


@pytest.fixture
def mounted(tmp_path):
    """A rig file whose camera is mirrored and turned."""
    file = tmp_path / "rig.toml"
    file.write_text(
        'name = "x"\ndriver = "simulated"\nleds = 4\n'
        "[mounting]\nrotation_deg = 90\nmirror = true\n[options]\nwidth = 64\nheight = 48\n"
    )
    return file


def test_check_says_how_the_camera_is_mounted(sgp, mounted):
    answer = sgp("rig", "check", "--rig", mounted)
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
    monkeypatch.setattr(rig.host.lines, "ports", dict)
    answer = sgp("rig", "list").ok()
    assert "no LED board was found" in answer.out
    assert "--cti" in answer.out


def test_a_missing_producer_is_reported_before_any_port_is_opened(sgp, monkeypatch, tmp_path):
    asked = []
    monkeypatch.setattr(rig.host.lines, "ports", lambda: asked.append(1) or {})
    answer = sgp("rig", "list", "--cti", tmp_path / "missing.cti")
    assert "missing.cti: no such file" in answer.error_line(2)
    assert not asked


def test_a_port_without_a_board_is_listed_as_a_port(sgp, tmp_path):
    answer = sgp("rig", "list", "--port", tmp_path / "none").ok()
    assert f"\nport     {tmp_path / 'none'}: the port cannot be opened" in answer.out


def test_a_frame_is_snapped_as_the_sensor_gave_it(bench, sgp, tmp_path):
    out = tmp_path / "frame.tif"
    words = ["rig", "snap", "--led", 4, "--exposure-us", 2000, "--out", out, "--rig", bench.rig]
    answer = sgp(*words).ok()
    assert bench.dark()
    # 5 electrons per us for 2000 us at 10 electrons per DN, plus the black level.
    assert (read_image(out) == 64 + 1000).all()
    view = read_image(out.with_suffix(".png"))
    assert view.dtype == np.uint8
    assert (view == round(255 * (1064 / 4095) ** (1 / 2.2))).all()
    assert "frame.png" in answer.out


def test_the_view_of_a_frame_is_upright_and_in_a_new_folder(sgp, mounted, tmp_path):
    out = tmp_path / "new" / "folder" / "frame.tif"
    words = ("rig", "snap", "--led", 1, "--out", out, "--rig", mounted)
    answer = sgp(*words, "--json").ok()
    raw, view = read_image(out), read_image(out.with_suffix(".png"))
    assert json.loads(answer.out)["outputs"]["view"] == str(out.with_suffix(".png"))
    assert (raw.shape, view.shape) == ((64, 48), (48, 64))
    # Mirrored left to right, then turned clockwise.
    upright = np.rot90(raw[:, ::-1], -1)
    assert (view == np.rint(255 * (upright / 4095) ** (1 / 2.2))).all()
    out.unlink()
    assert "frame.png already exists" in sgp(*words).error_line(2)
    assert not out.exists()


def turn_off(bench, sgp):
    """Turn off an LED that another program left on."""
    board = Board(bench.board.port)
    board.on(3, 50_000)
    board.close()
    assert sgp("rig", "off", "--rig", bench.rig).code == 0
    assert bench.dark()


def test_off_turns_off_an_led_that_another_program_left_on(bench, sgp):
    turn_off(bench, sgp)


def test_lights_need_no_camera(bench, sgp):
    bench.options["cti"] = "/nowhere/maker.cti"
    turn_off(bench, sgp)
    sgp("rig", "light", 5, "--seconds", 0.2, "--rig", bench.rig).ok()
    assert (bench.state.periods()[-1].led, bench.dark()) == (5, True)
    assert "maker.cti" in sgp("rig", "check", "--rig", bench.rig).error_line(3)


def test_first_light_needs_no_rig_file(bench, sgp, monkeypatch):
    monkeypatch.setattr(rig.host.lines, "ports", lambda: {bench.board.port: "its socket"})
    assert sgp("rig", "light", 0, "--seconds", 0.2, "--rig", "bench").code == 0
    assert bench.state.periods()[-1].led == 0
    assert bench.dark()


def test_an_led_that_turns_off_by_itself_is_reported(bench, sgp):
    bench.options["cti"] = "/nowhere/maker.cti"
    bench.board.set_faults(BoardFault(kind="goes-dark", verb="ON", value=100))
    line = sgp("rig", "light", 5, "--seconds", 0.6, "--rig", bench.rig).error_line(3)
    assert "LED 5 was turned on, but no LED was on at the end" in line


def test_light_stays_on_for_longer_than_the_watchdog_time(bench, sgp):
    sgp("rig", "light", 5, "--seconds", 1.6, "--rig", bench.rig).ok()
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
    _, err = host.communicate(timeout=100)
    assert host.returncode == 130
    assert b"stopped by Ctrl-C" in err
    assert bench.dark()
