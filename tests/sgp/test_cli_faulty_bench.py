"""A faulty bench gets one clear line, and stays dark."""

import contextlib
import re

import pytest

import rig.board.ports
from rig import Board
from rig.board import Command, LineError, Reply, decode_command, encode_reply
from tests.quick_sample import quick
from tests.sgp.virtual_bench import Bench, device


def of_protocol_1(heard: bytes) -> bytes:
    replies = b""
    for line in heard.splitlines():
        with contextlib.suppress(LineError):
            command: Command = decode_command(line)
            words = ("sgp-led-board", "1", "1.0.0", "36", "10000")
            replies += encode_reply(Reply(command.seq, command.verb, words))
    return replies


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


@pytest.mark.parametrize(
    ("words", "options"), [(["check"], {}), (["light", 5], {"cti": "/nowhere/maker.cti"})]
)
def test_a_board_of_24_leds_for_a_rig_of_36(tmp_path, sgp, words, options):
    with contextlib.closing(Bench(tmp_path, leds=24)) as bench:
        bench.options |= options
        line = sgp("rig", *words, "--rig", bench.rig).error_line(3)
        assert "has 24 LEDs, but rig bench 1 is configured with 36" in line
        Board(bench.board.port).close()


def test_no_board_at_any_port(bench, sgp, monkeypatch):
    monkeypatch.setattr(rig.host.lines, "ports", dict)
    bench.options["port"] = "auto"
    assert "no LED board" in sgp("rig", "off", "--rig", bench.rig).error_line(3)


def test_the_board_is_found_by_itself(bench, sgp, monkeypatch):
    monkeypatch.setattr(rig.host.lines, "ports", lambda: {bench.board.port: "its socket"})
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
