"""The complete simulated rig: the real client and controller with virtual devices."""

import os
import time
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from acquisition import NoiseModel
from rig import Board, BoardError, Mounting, Rig, RigConfig, RigConfigError, RigError
from rig.genicam import GenICamCamera, open_genicam
from rig.shooting import Wires
from simulator import (
    bench_sensor,
    open_rig,
    open_rig_seeing,
    read_scene,
    render,
    scene_named,
    simulated_rig,
)
from simulator.camera import GentlCamera, GentlDevice, ImageFormation, VirtualCamera, fixed_pattern
from simulator.led_board import VirtualBoard
from simulator.rigs import bench_rig as _simulated_rig
from tests.quick_sample import quick
from tests.simulator.camera_options import grouped

H, W = 512, 640
NOISE = NoiseModel(2.5, 2.0, 64.0, 12)
CONFIG = RigConfig(name="simulated", driver="simulated")


def planes(led):
    """A bright spot that moves with the LED."""
    plane = np.zeros((H, W), np.float32)
    if led is not None:
        plane[10 * led : 10 * led + 10] = 0.5
    return plane


def started(config=CONFIG, seen=planes, size=(H, W), noise=NOISE, **options):
    return simulated_rig(seen, config, **grouped(size=size, noise=noise, **options))


def test_a_pass_of_36_leds_sees_every_led_in_time_and_leaves_no_files():
    rig = started(seed=1)
    with rig:
        assert rig.camera.info.serial == "virtual-camera"
        assert rig.board.identity.leds == 36
        start = time.monotonic()
        shots = [rig.shoot(led, 10_000) for led in range(36)]
        seconds = time.monotonic() - start
    for led, shot in enumerate(shots):
        rows = shot.frame.pixels.astype(np.float64).mean(axis=1)
        lit = np.flatnonzero(rows > 1000)
        assert lit.tolist() == list(range(10 * led, 10 * led + 10))
        # 0.5 e/us * 10 ms / 2.5 e/DN + 64 DN
        assert rows[lit].mean() == pytest.approx(2064, abs=2)
    # 1.3 s if nothing else runs, of which 0.43 s are exposures and settling. If every command were
    # repeated once, it would be 19 s.
    assert seconds < 10.0


def test_the_same_seed_gives_the_same_bytes():
    def take():
        with started(realtime=False, seed=5) as rig:
            return [rig.shoot(led, 10_000).frame.pixels for led in (3, 3, None, 4)]

    one, other = take(), take()
    assert all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))
    assert not np.array_equal(one[0], one[1])


def test_closing_ends_the_boards_process(monkeypatch):
    boards = []

    class Noted(_simulated_rig.VirtualBoard):
        def __init__(self, leds):
            super().__init__(leds)
            boards.append(self)

    monkeypatch.setattr(_simulated_rig, "VirtualBoard", Noted)
    cameras = []

    class Kept(_simulated_rig.GentlCamera):
        def __init__(self, *args, **options):
            super().__init__(*args, **options)
            cameras.append(self)

    monkeypatch.setattr(_simulated_rig, "GentlCamera", Kept)
    for kind in ("gentl", "inside"):
        started(camera=kind).close()

    def broken(*args, **options):
        raise RigError("the camera does not open")

    for kind, maker in (("gentl", "open_genicam"), ("inside", "VirtualCamera")):
        monkeypatch.setattr(_simulated_rig, maker, broken)
        with pytest.raises(RigError, match="the camera does not open"):
            started(camera=kind)
    assert len(boards) == 4
    assert len(cameras) == 2
    for camera in cameras:
        assert not camera.cti.exists()
    for board in boards:
        assert not board.bench_state_path.exists()
        with pytest.raises(ProcessLookupError):
            os.kill(board.pid, 0)


@pytest.mark.parametrize("kind", ["auto", "gentl"])
def test_the_camera_is_behind_a_genicam_producer(kind):
    with started(camera=kind) as rig:
        assert isinstance(rig.camera, GenICamCamera)
        assert rig.camera.info.model == "virtual camera"


@pytest.mark.parametrize("depth", quick([8, 10, 12, 14, 16], every=2))
@pytest.mark.parametrize("cfa", [None, "GRBG"])
def test_the_rigs_camera_has_the_depth_of_its_sensor(depth, cfa):
    noise = replace(NOISE, bit_depth=depth)
    with started(noise=noise, cfa=cfa) as rig:
        assert (rig.camera.info.bit_depth, rig.camera.info.cfa) == (depth, cfa)
        # The GenICam camera does not support 14 bits.
        assert isinstance(rig.camera, VirtualCamera if depth == 14 else GenICamCamera)


def test_without_a_compiler_the_camera_is_inside_and_its_model_names_the_reason(monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler")
    with started() as rig:
        assert isinstance(rig.camera, VirtualCamera)
        assert rig.camera.info.model.startswith("virtual camera in Python (")
    with pytest.raises(RigError, match="needs a C compiler"):
        started(camera="gentl")


def test_only_the_camera_inside_can_run_without_waiting():
    with started(realtime=False) as rig:
        assert isinstance(rig.camera, VirtualCamera)
        assert rig.camera.info.model == "virtual camera"
    with pytest.raises(RigConfigError, match="use the camera 'inside'"):
        started(camera="gentl", realtime=False)


@pytest.mark.parametrize("trigger", quick(["software", "board"], every=2))
def test_both_cameras_see_the_same_in_every_mode(trigger):
    def take(kind):
        config = CONFIG.model_copy(update={"trigger": trigger})
        with started(config, camera=kind, seed=5) as rig:
            single = [rig.shoot(led, 3000).frame.pixels for led in (3, None)]
            return single + [shot.frame.pixels for shot in rig.sequence([4, 5, 6], 3000)]

    for one, other in zip(take("gentl"), take("inside"), strict=True):
        apart = np.abs(one.astype(int) - other)
        assert apart.max() <= 1
        assert (apart > 0).mean() < 1e-4


def test_a_rolling_shutter_is_lit_from_its_first_row_to_its_last():
    exposure_us, readout_us = 4000.0, 30_000.0
    with (
        VirtualBoard(4) as board,
        GentlCamera(
            lambda led: np.full((64, 80), 0.0 if led is None else 0.5, np.float32),
            size=(64, 80),
            leds=4,
            bench_state_path=board.bench_state_path,
            formation=ImageFormation(NOISE, noisy=False),
            device=GentlDevice(shutter="rolling", readout_us=readout_us, frame_rate_hz=25.0),
        ) as camera,
    ):
        for trigger in ("software", "board"):
            config = RigConfig(name="rolling", driver="test", leds=4, trigger=trigger)
            with Rig(Board(board.port), open_genicam(camera.cti), config) as rig:
                assert (rig.camera.info.shutter, rig.camera.info.readout_us) == (
                    *("rolling", pytest.approx(readout_us, rel=0.05)),
                )
                shots = [rig.shoot(2, exposure_us), *rig.sequence([0, 1, 3], exposure_us)]
            for shot in shots:
                # A row that is dark for a tenth of its exposure would be 80 grey values darker.
                rows = shot.frame.pixels.astype(float).mean(axis=1)
                np.testing.assert_allclose(rows, 64 + 0.5 * exposure_us / 2.5, atol=1.0)


def test_the_board_sees_the_exposure():
    # Long: on a busy machine, both processes may wait for several milliseconds.
    exposure_us = 50_000
    config = CONFIG.model_copy(update={"trigger": "board", "exposure_active": True})
    with started(config) as rig:
        assert rig.shoot(3, exposure_us).led == 3
        assert [shot.led for shot in rig.sequence([1, 2, 3], exposure_us)] == [1, 2, 3]
        assert rig.wires(0, exposure_us) == Wires(trigger=True, exposure_active=True)


@pytest.mark.parametrize(
    ("mirror", "rotation_deg", "kind"),
    quick(product([False, True], [0, 90, 180, 270], ["gentl", "inside"]), every=3),
)
def test_a_rotated_camera_delivers_rotated_frames(kind, rotation_deg, mirror):
    mounting = Mounting(rotation_deg=rotation_deg, mirror=mirror)
    config = RigConfig(name="turned", driver="simulated", leds=2, mounting=mounting)
    picture = np.linspace(0.05, 0.6, 12 * 20, dtype=np.float32).reshape(12, 20)

    def scene(led):
        return picture if led is not None else np.zeros_like(picture)

    options = {"noisy": False, "cfa": "GRBG", "camera": kind}
    with started(config, scene, (12, 20), **options) as rig:
        info, pixels = rig.camera.info, rig.shoot(0, 4000).frame.pixels
    assert pixels.shape == (info.height, info.width)
    assert pixels.shape == ((12, 20) if rotation_deg in (0, 180) else (20, 12))
    assert mounting.upright_cfa(info.cfa, pixels.shape) == "GRBG"
    np.testing.assert_allclose(mounting.upright(pixels), 64 + picture * 4000 / 2.5, atol=0.6)


def test_two_rigs_at_once_are_independent():
    options = {"noisy": False, "realtime": False}
    with (
        started(**options) as one,
        started(**options) as other,
    ):
        other.board.on(30, 5000)
        pixels = one.shoot(2, 10_000).frame.pixels
        assert np.flatnonzero(pixels.max(axis=1) > 100).tolist() == list(range(20, 30))
        with pytest.raises(BoardError, match="error 3"):
            other.board.on(36, 100)


def opened(**options):
    options = {"scene": "spheres", "width": 48, "height": 32, "realtime": False, **options}
    config = RigConfig(name="bench 1", driver="simulated", leds=4, settle_ms=0.0, options=options)
    return open_rig(config)


def frames(*shots, **options):
    with opened(**options) as rig:
        return [
            rig.shoot(led, exposure_us).frame.pixels.astype(float) for led, exposure_us in shots
        ]


def test_the_driver_accepts_sensor_lamps_and_shake_as_options():
    shots = [(0, 5000), (1, 5000), (None, 5000)]
    plain = frames(*shots, noise=False)
    # 8 bits, 20 electrons per DN and half the photons instead of 12 bits and 2.5 electrons per DN.
    sensor = {"bit_depth": 8, "electrons_per_dn": 20.0, "black_level_dn": 4.0}
    sensor["quantum_efficiency"] = 0.5
    coarse = frames(*shots, noise=False, sensor=sensor, lamps={"dead": [1]})
    fits = plain[0] < 4095
    np.testing.assert_allclose(coarse[0][fits], ((plain[0] - 64) / 16 + 4)[fits], atol=0.54)
    assert np.array_equal(coarse[1], coarse[2])
    assert not np.array_equal(coarse[0], coarse[2])


def test_the_driver_accepts_wrong_wiring():
    shots = [(led, 5000) for led in (0, 1, 2, 3, None)]
    zero, one, two, three, dark = frames(*shots, noise=False)
    wiring = {"swapped": [[0, 1]], "always": [2]}
    seen = frames(*shots, noise=False, wiring=wiring)
    np.testing.assert_allclose(seen[0], np.minimum(one + two - dark, 4095), atol=1.01)
    np.testing.assert_allclose(seen[1], np.minimum(zero + two - dark, 4095), atol=1.01)
    np.testing.assert_allclose(seen[2], two, atol=1.01)
    np.testing.assert_allclose(seen[4], two, atol=1.01)
    seen = frames(*shots, noise=False, wiring={"double": [[1, 3]]})
    np.testing.assert_allclose(seen[1], np.minimum(one + three - dark, 4095), atol=1.01)
    assert np.array_equal(seen[1], seen[3])


def test_the_driver_accepts_a_sensor_seed_and_shake():
    uneven = {"dsnu_e": 30.0}
    dark, one, other = frames(
        (None, 10), (0, 5000), (0, 5000), noise=False, sensor=uneven, sensor_seed=3, shake_px=0.1
    )
    offset = fixed_pattern(replace(bench_sensor(), **uneven), (32, 48), seed=3).maps[1]
    # The ambient light gives less than two electrons in 10 us.
    np.testing.assert_allclose(dark, 64 + offset / 2.5, atol=1.0)
    assert not np.array_equal(one, other)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"lamps": {"glow": 1}}, r"\[lamps\]: unknown key 'glow'; known"),
        ({"lamps": {"flicker": "a lot"}}, r"\[lamps\]: key 'flicker'"),
        ({"lamps": {"flicker": -1}}, r"lamps: flicker is -1"),
        ({"lamps": {"dead": [4]}}, r"dead LEDs \[4\] must be within 0\.\.3"),
        ({"lamps": 3}, "option 'lamps'"),
        ({"sensor": {"iso": 100}}, r"\[sensor\]: unknown key 'iso'"),
        ({"sensor": {"prnu": 2.0}}, "prnu within 0..0.3"),
        ({"height": None}, "'width' or 'height' is missing"),
        ({"scene": "no/such.toml"}, "no/such.toml: no such file"),
        ({"sensor_seed": -1}, "option 'sensor_seed'"),
        ({"shake_px": -0.1}, "option 'shake_px'"),
        ({"camera": "outside"}, "option 'camera'"),
        ({"camera": "gentl"}, "use the camera 'inside'"),
        ({"wiring": {"swap": [[0, 1]]}}, r"\[wiring\]: unknown key"),
        ({"wiring": {"always": [4]}}, r"wrongly wired LEDs \[4\] must"),
        ({"wiring": {"double": [[0, 0]]}}, "listed only once"),
        ({"shake": 0.1}, "unknown option 'shake'; known are scene"),
    ],
)
def test_an_invalid_option_of_sensor_lamps_or_shake_is_reported_in_one_line(options, message):
    with pytest.raises(RigConfigError, match=message) as caught:
        opened(**options)
    assert str(caught.value).startswith("rig bench 1: ")
    assert "\n" not in str(caught.value)


def test_a_mosaic_scene_is_seen_by_a_mosaic_camera():
    scene = scene_named("coin-with-spheres", width=48, height=32, leds=3)
    rendering = render(replace(scene, lens=replace(scene.lens, cfa="GRBG")))
    config = RigConfig(name="bench 1", driver="simulated", leds=3, settle_ms=0.0)
    with open_rig_seeing(rendering, config, noisy=False, realtime=False) as rig:
        assert rig.camera.info.cfa == "GRBG"
        assert rig.camera.info.pixel_format == "BayerGR12"
        seen = rig.shoot(1, 2000).frame.pixels
    expected = 64 + 2000 * (rendering.planes[1] + rendering.ambient) / 2.5
    np.testing.assert_allclose(seen, np.minimum(expected, 4095), atol=0.51)


def test_a_scene_file_determines_the_frames(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(
        "seed = 3\nelectrons_per_us = 0.3\n[lights]\nkind = 'ring'\ncount = 4\n"
        "[lens]\nkind = 'perspective'\nwidth = 40\nheight = 30\n"
        "[lamps]\ndead = [2]\n[sensor]\nblack_level_dn = 80.0\n"
    )
    rendering = render(read_scene(path))
    options = {"scene": str(path), "width": None, "height": None, "noise": False}
    dead, lit = frames((2, 9000), (1, 9000), **options)
    ambient = 80 + 9000 * rendering.ambient / 2.5
    np.testing.assert_allclose(dead, ambient, atol=0.51)
    np.testing.assert_allclose(lit, ambient + 9000 * rendering.planes[1] / 2.5, atol=0.51)


def test_a_scene_file_with_another_number_of_leds_is_refused(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text("[lights]\nkind = 'ring'\ncount = 5\n[lens]\nkind = 'orthographic'\n")
    with pytest.raises(RigConfigError, match="has 4 LEDs, its scene has 5"):
        opened(scene=str(path))
