"""A board or camera that is gone is opened again, if it is the same."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import pytest

from rig import (
    Board,
    BoardError,
    BoardGoneError,
    CameraError,
    CameraGoneError,
    DeviceGoneError,
)
from rig.board import ports
from rig.board.ports import BoardPlace
from rig.host import clock, lines
from rig.shooting import lights_off
from tests.cases import cases
from tests.rig.conftest import led_on, led_seen

EXPOSURE_US = 1000.0
SECOND_NS = 1_000_000_000
TRIGGERS = pytest.mark.parametrize("trigger", ["software", "board"])


def gone(rig, kind=DeviceGoneError):
    """Return the error of the next shot."""
    with pytest.raises(kind) as error:
        rig.shoot(3, EXPOSURE_US)
    return error.value


def check_shots(bench, rig):
    for led in (5, 0, None):
        shot = rig.shoot(led, EXPOSURE_US)
        assert (led_seen(shot.frame), shot.led, led_on(bench)) == (led, led, None)


@TRIGGERS
def test_a_camera_that_is_back_takes_the_next_shot(bench, trigger):
    with bench.rig(trigger=trigger) as rig:
        check_shots(bench, rig)
        rig.camera.unplug()
        error = gone(rig, CameraGoneError)
        assert (error.device, led_on(bench)) == ("camera", None)
        rig.recover(error)
        check_shots(bench, rig)


@TRIGGERS
@pytest.mark.parametrize("port", [None, "another"])
def test_a_board_that_is_back_takes_the_next_shot(bench, trigger, port):
    with bench.rig(trigger=trigger) as rig:
        check_shots(bench, rig)
        bench.virtual.unplug(10 * SECOND_NS, port)
        began_s = clock.monotonic()
        rig.recover(gone(rig, BoardGoneError))
        assert 9 < clock.monotonic() - began_s < 12
        assert rig.board.port == bench.virtual.port == (port or "world")
        check_shots(bench, rig)


@pytest.mark.parametrize("device", ["board", "camera"])
def test_a_sequence_continues_with_a_device_that_is_back(bench, device):
    with bench.rig(trigger="board", frame_period_ms=20.0, frame_timeout_s=0.3) as rig:
        sequence = rig.sequence([1, 2, 3, 4], EXPOSURE_US)
        assert next(sequence).led == 1
        bench.virtual.unplug(SECOND_NS) if device == "board" else rig.camera.unplug()
        with pytest.raises(DeviceGoneError) as error:
            list(sequence)
        assert error.value.device == device
        rig.recover(error.value)
        shots = list(rig.sequence([2, 3, 4], EXPOSURE_US))
        assert [led_seen(shot.frame) for shot in shots] == [2, 3, 4]


def test_a_camera_that_is_gone_during_a_flash_is_recognised(bench, monkeypatch):
    with bench.rig(trigger="board") as rig:
        check_shots(bench, rig)
        flash = rig.board.flash

        def flash_and_unplug(*words):
            rig.camera.unplug()
            return flash(*words)

        monkeypatch.setattr(rig.board, "flash", flash_and_unplug)
        rig.recover(gone(rig, CameraGoneError))
        monkeypatch.undo()
        check_shots(bench, rig)


def test_a_board_that_restarted_while_the_camera_was_gone_takes_the_next_shot(bench):
    with bench.rig(frame_period_ms=500.0) as rig:
        rig.camera.unplug()
        error = gone(rig)
        clock.sleep(5)
        bench.virtual.reset()
        rig.recover(error)
        check_shots(bench, rig)


def test_both_may_be_gone(bench):
    with bench.rig() as rig:
        rig.camera.unplug()
        error = gone(rig, CameraGoneError)
        bench.virtual.unplug(SECOND_NS, "another")
        rig.recover(error)
        rig.recover(gone(rig, BoardGoneError))
        check_shots(bench, rig)


def test_a_signal_turns_off_the_board_that_is_open_now(bench):
    with bench.rig() as rig:
        bench.virtual.unplug(SECOND_NS, "another")
        rig.recover(gone(rig))
        rig.board.on(4, 5000)
        (darken,) = lights_off.watched.values()
        darken()
        clock.sleep(0.1)
        assert led_on(bench) is None


def test_an_led_that_stayed_on_is_turned_off(bench):
    with bench.rig() as rig:
        rig.board.on(4, 5000)
        bench.virtual.unplug(SECOND_NS // 10)
        rig.recover(gone(rig))
        assert led_on(bench) is None


def test_closing_closes_what_was_opened_again(bench):
    rig = bench.rig()
    rig.camera.unplug()
    rig.recover(gone(rig))
    bench.virtual.unplug(SECOND_NS)
    rig.recover(gone(rig))
    camera = rig.camera
    rig.close()
    Board(bench.virtual.port).close()
    with pytest.raises(CameraError, match="is closed"):
        camera.arm()


@pytest.mark.parametrize("device", ["board", "camera"])
def test_a_device_that_stays_away_is_the_first_error(bench, device, monkeypatch):
    def nowhere():
        raise CameraError("no camera found")

    monkeypatch.setattr(bench, "camera", bench.camera)
    rig = bench.rig(reconnect_s=12.0)
    if device == "board":
        bench.virtual.unplug()
    else:
        rig.camera.unplug()
        bench.camera = nowhere
    error = gone(rig)
    began_s = clock.monotonic()
    with pytest.raises(type(error)) as raised:
        rig.recover(error)
    assert raised.value is error
    assert 12 <= clock.monotonic() - began_s < 12.5
    said = {"board": "no such port", "camera": "no camera found"}[device]
    (note,) = [one for one in error.__notes__ if one.startswith("on opening it again")]
    assert said in note
    # What is gone is closed.
    with pytest.raises(BoardGoneError) if device == "board" else nullcontext():
        rig.close()


def test_an_exception_ends_the_wait_and_a_device_that_opens_later_is_closed(bench, monkeypatch):
    opened = []

    def slowly():
        clock.sleep(5)
        opened.append(camera())
        return opened[0]

    camera = bench.camera
    monkeypatch.setattr(bench, "camera", camera)
    with bench.rig() as rig:
        rig.camera.unplug()
        bench.camera = slowly
        error = gone(rig)
        began_s = clock.monotonic()

        def asked():
            if clock.monotonic() > began_s + 1:
                raise InterruptedError

        with pytest.raises(InterruptedError):
            rig.recover(error, asked)
        assert clock.monotonic() - began_s < 1.2
        clock.sleep(6)
        with pytest.raises(CameraError, match="is closed"):
            opened[0].arm()
        bench.camera = camera
        rig.recover(error)
        check_shots(bench, rig)


def test_a_camera_that_takes_too_long_to_open_is_given_up(bench, monkeypatch):
    with bench.rig(reconnect_s=2.0) as rig:
        rig.camera.unplug()
        monkeypatch.setattr(bench, "camera", lambda: clock.sleep(3000))
        error = gone(rig)
        with pytest.raises(CameraGoneError):
            rig.recover(error)
        assert error.__notes__ == ["on opening it again: it takes too long to open"]


@cases(
    ("changed", "said"),
    {
        "another camera": ({"serial": "c8"}, "serial was virtual-camera and is c8"),
        "another format": ({"bit_depth": 10}, "bit_depth was 12 and is 10"),
        "another setting": ({"settings": {"Gamma": 2.0}}, "Gamma was None and is 2.0"),
    },
)
def test_a_camera_that_differs_is_refused(bench, monkeypatch, changed, said):
    camera = bench.camera

    def other():
        device = camera()
        device.info = replace(device.info, **changed)
        return device

    monkeypatch.setattr(bench, "camera", camera)
    with bench.rig(reconnect_s=1.0) as rig:
        rig.camera.unplug()
        bench.camera = other
        error = gone(rig)
        with pytest.raises(CameraGoneError):
            rig.recover(error)
        assert error.__notes__[-1].endswith(f"is not as before: {said}")
        # Processing that is off already, and a frame period of another exposure, are no difference.
        changed.clear()
        changed |= {"turned_off": ("Gamma",), "frame_period_us": 77.0}
        rig.recover(error)
        check_shots(bench, rig)


def test_another_board_is_refused(bench, world):
    with bench.rig(reconnect_s=1.0) as rig:
        world.board.unplug()
        world.connect(35)
        error = gone(rig)
        with pytest.raises(BoardGoneError):
            rig.recover(error)
        assert "is another one: leds was 36 and is 35" in error.__notes__[-1]
        world.connect(36)
        rig.recover(error)
        assert rig.board.identity.leds == 36


def test_a_driver_that_fails_in_any_way_is_asked_again(bench, monkeypatch):
    def starting():
        bench.camera = camera
        raise ValueError("the camera is still starting")

    camera = bench.camera
    monkeypatch.setattr(bench, "camera", camera)
    with bench.rig() as rig:
        rig.camera.unplug()
        error = gone(rig)
        bench.camera = starting
        rig.recover(error)
        check_shots(bench, rig)


def test_a_camera_that_cannot_be_armed_yet_is_opened_once_more(bench, monkeypatch):
    def refused(*words):
        raise CameraError("busy")

    def opened():
        cameras.append(camera())
        if len(cameras) == 1:
            cameras[0].arm = refused
        return cameras[-1]

    cameras, camera = [], bench.camera
    monkeypatch.setattr(bench, "camera", camera)
    with bench.rig() as rig:
        rig.camera.unplug()
        error = gone(rig)
        bench.camera = opened
        rig.recover(error)
        assert rig.camera is cameras[1]
        with pytest.raises(CameraError, match="is closed"):
            cameras[0].disarm()
        check_shots(bench, rig)


def test_a_rig_that_cannot_open_its_camera_says_so(bench):
    with bench.rig(reconnect_s=1.0) as rig:
        rig._open_camera = None
        rig.camera.unplug()
        error = gone(rig)
        with pytest.raises(CameraGoneError):
            rig.recover(error)
        assert "cannot open its camera again" in error.__notes__[-1]


OWN, OTHER = ("ttyUSB0", "own"), ("ttyUSB1", "other")


@cases(
    ("before", "after", "found"),
    {
        "on the same port": ([OWN, OTHER], [OWN, OTHER], "ttyUSB0"),
        "renamed": ([OWN, OTHER], [OTHER, ("ttyUSB2", "own")], "ttyUSB2"),
        "in another socket": ([OWN, OTHER], [OTHER, ("ttyUSB2", "new")], "ttyUSB2"),
        "names exchanged": ([OWN, OTHER], [("ttyUSB1", "own"), ("ttyUSB0", "other")], "ttyUSB1"),
        "the other has its name": ([OWN, OTHER], [("ttyUSB0", "other")], None),
        "the other stays": ([OWN, OTHER], [OTHER], None),
        "not a device of the system": ([OTHER], [OTHER], "ttyUSB0"),
    },
)
def test_a_board_is_found_by_what_tells_it_from_others(monkeypatch, board, before, after, found):
    """All boards are of the same kind."""
    opened = []

    def open_board(port):
        if port not in dict(after) and port != found:
            raise BoardError("no such port")
        opened.append(port)
        return SimpleNamespace(port=port, identity=board.identity)

    monkeypatch.setattr(ports, "Board", open_board)
    monkeypatch.setattr(lines, "ports", lambda: dict(before))
    place = BoardPlace(SimpleNamespace(port="ttyUSB0", identity=board.identity))
    monkeypatch.setattr(lines, "ports", lambda: dict(after))
    if found is None:
        with pytest.raises(BoardError):
            place.open()
    else:
        assert place.open().port == found
    assert opened == ([] if found is None else [found])
