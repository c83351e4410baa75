"""Pre-flight: a working rig passes, and each possible fault is found and named."""

from __future__ import annotations

import json
import os
import shutil
import stat
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, cast

import cv2
import numpy as np
import pytest

from acquisition import CapturePlan
from acquisition.preflights import Check, Preflight, preflight
from acquisition.preflights import rig as _check_rig
from acquisition.preflights.rig import check_camera, check_disk
from acquisition.preflights.trial_frames import (
    Trials,
    check_exposure,
    check_focus,
    check_response,
    check_room,
    check_steadiness,
    detail,
)
from rig import BoardError, RigConfig
from rig.arrays import Float64, UInt16
from simulator import BenchFlaws, Rendering, open_rig_seeing, render, scene_named
from simulator.camera import VirtualCamera
from simulator.gentl import CompilerError, build
from simulator.rigs import bench_rig as _simulated_rig
from simulator.scene import Lamps

LEDS = 8
PLAN = CapturePlan(repeat=False, leds=tuple(range(LEDS)), exposures_us=(20_000.0, 1000.0))
WHITE_DN = 4095.0
IN_WORLD = pytest.mark.usefixtures("simulated_world")


class Usage(NamedTuple):
    total: int
    used: int
    free: int


@pytest.fixture(scope="module")
def rendering() -> Rendering:
    return render(scene_named("coin", width=160, height=128, leds=LEDS, seed=4))


def flown(rendering: Rendering, plan: CapturePlan, folder: Path, **rig: Any) -> Preflight:
    values = {"seed": 2, "realtime": False, "camera": "inside", **rig}
    with open_rig_seeing(rendering, **values) as opened:
        return preflight(opened, plan, folder, self_test=False)


def states(flight: Preflight) -> dict[str, str]:
    return {check.name: check.state for check in flight.checks}


def named(flight: Preflight, name: str) -> Check:
    return next(check for check in flight.checks if check.name == name)


@IN_WORLD
def test_a_working_rig_passes_and_no_file_is_left(rendering: Rendering, tmp_path: Path) -> None:
    reports: list[tuple[str, int, int]] = []
    with open_rig_seeing(rendering, seed=2, realtime=False, camera="inside") as rig:
        flight = preflight(
            rig,
            PLAN,
            tmp_path / "new" / "session",
            on_progress=lambda *report: reports.append(report),
        )
        assert rig.board.status().led is None
    assert set(states(flight).values()) == {"ok"}, flight.checks
    assert flight.ok
    assert list(tmp_path.iterdir()) == []
    names = list(states(flight))
    assert reports == [("checking", n, len(names)) for n in range(1, len(names) + 1)]
    assert names[:3] == ["disk", "board", "camera"]
    assert names[-1] == "LEDs"
    details = json.loads(json.dumps(flight.details(), allow_nan=False))
    assert [check["name"] for check in details["checks"]] == list(states(flight))


@IN_WORLD
def test_a_dead_led_fails_only_plans_that_use_it(rendering: Rendering, tmp_path: Path) -> None:
    config = RigConfig(name="sim", driver="simulated", leds=LEDS)
    with open_rig_seeing(
        rendering,
        config,
        seed=2,
        realtime=False,
        camera="inside",
        flaws=BenchFlaws(lamps=Lamps(dead=(3,))),
    ) as rig:
        flight = preflight(rig, PLAN, tmp_path)
        rest = preflight(rig, PLAN.without((3,))[0], tmp_path)
    assert named(flight, "LEDs").state == "failed"
    assert "LED 3" in named(flight, "LEDs").text
    assert not flight.ok
    assert named(rest, "LEDs").state == "warning"
    assert rest.ok


@IN_WORLD
def test_a_flickering_lamp_is_reported_with_a_suitable_exposure(
    rendering: Rendering, tmp_path: Path
) -> None:
    pulsed = BenchFlaws(lamps=Lamps(pwm_hz=1e6 / 1024, pwm_duty=0.3))
    flight = flown(rendering, PLAN, tmp_path, flaws=pulsed)
    assert named(flight, "steadiness").state == "warning"
    assert "1024 us" in named(flight, "steadiness").text
    # An exposure of an integer number of periods is steady.
    plan = CapturePlan(repeat=False, leds=PLAN.leds, exposures_us=(20_480.0, 1024.0))
    assert states(flown(rendering, plan, tmp_path, flaws=pulsed))["steadiness"] == "ok"


UNSUITABLE = {
    "too-short": ((100.0,), {}, "exposure", "warning", "lengthen"),
    "too-long": ((150_000.0,), {}, "exposure", "warning", "shorten"),
    "over-the-plan's-limit": (
        (60_000.0, 1000.0),
        {"max_clipped_fraction": 0.0},
        "exposure",
        "failed",
        "the plan allows 0.00%",
    ),
    "not-a-step-of-the-camera": ((20_000.4,), {}, None, "ok", ""),
    "coarse-step": ((11.4,), {}, "camera", "warning", "11 us instead of 11.4 us"),
}


@IN_WORLD
@pytest.mark.parametrize(
    ("exposures_us", "others", "name", "state", "said"), UNSUITABLE.values(), ids=UNSUITABLE
)
def test_unsuitable_exposures(
    rendering: Rendering,
    tmp_path: Path,
    exposures_us: tuple[float, ...],
    others: dict[str, Any],
    name: str | None,
    state: str,
    said: str,
) -> None:
    plan = CapturePlan(repeat=False, leds=PLAN.leds, exposures_us=exposures_us, **others)
    flight = flown(rendering, plan, tmp_path)
    if name is None:
        assert set(states(flight).values()) == {"ok"}
    else:
        assert named(flight, name).state == state
        assert said in named(flight, name).text
    assert flight.ok is (state != "failed")


@IN_WORLD
def test_an_exposure_beyond_the_camera_fails_and_checks_of_frames_are_not_done(
    rendering: Rendering, tmp_path: Path
) -> None:
    plan = CapturePlan(repeat=False, leds=PLAN.leds, exposures_us=(5.0,))
    flight = flown(rendering, plan, tmp_path)
    assert "exposes for 10 to 1e+07 us, not for 5" in named(flight, "camera").text
    assert states(flight)["disk"] == states(flight)["board"] == "ok"
    assert list(states(flight).values())[3:] == ["not done"] * 6
    assert not flight.ok


@pytest.mark.parametrize(
    ("automatics", "nodes", "said"),
    [
        pytest.param((), "", "automatics off", id="none-was-on"),
        pytest.param(
            ("gain", "gamma"),
            "GainAuto, GammaEnable, Gamma",
            "automatics off (on when it was opened: GainAuto, GammaEnable, Gamma)",
            id="two-were-on",
        ),
    ],
)
def test_automatic_functions_that_were_on_are_named(
    rendering: Rendering,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    automatics: tuple[str, ...],
    nodes: str,
    said: str,
) -> None:
    try:
        build()
    except CompilerError as error:
        pytest.skip(str(error))
    made = partial(_simulated_rig.GentlDevice, automatics=automatics)
    monkeypatch.setattr(_simulated_rig, "GentlDevice", made)
    plan = CapturePlan(repeat=False, leds=PLAN.leds, exposures_us=(1000.0,))
    with open_rig_seeing(rendering, seed=2, camera="gentl") as rig:
        check = check_camera(rig, plan)
    assert check.state == "ok"
    assert check.values["turned_off"] == nodes
    assert check.text.endswith(said)


@IN_WORLD
def test_a_plan_for_another_board_fails(rendering: Rendering, tmp_path: Path) -> None:
    plan = CapturePlan(repeat=False, leds=(0, LEDS), exposures_us=(1000.0,))
    assert "LED 8 does not exist" in named(flown(rendering, plan, tmp_path), "board").text


@IN_WORLD
def test_an_exposure_beyond_the_longest_hold_of_the_board_fails(
    rendering: Rendering, tmp_path: Path
) -> None:
    plan = CapturePlan(repeat=False, leds=PLAN.leds, exposures_us=(9e7,))
    assert "the plan requires 90002" in named(flown(rendering, plan, tmp_path), "board").text


@IN_WORLD
def test_a_camera_error_is_a_failed_check_with_its_message(
    rendering: Rendering, tmp_path: Path
) -> None:
    with open_rig_seeing(rendering, seed=2, realtime=False, camera="inside") as rig:
        cast(VirtualCamera, rig.camera).faults[4] = "lost"
        flight = preflight(rig, PLAN, tmp_path)
        assert rig.board.status().led is None
    assert states(flight)["camera"] == "ok"
    assert "frame 4 did not come" in named(flight, "response").text
    assert states(flight)["response"] == "failed"
    assert states(flight)["LEDs"] == "not done"


@IN_WORLD
def test_a_board_that_does_not_answer_is_a_failed_check(
    rendering: Rendering, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def silent() -> None:
        raise BoardError("LED board on /dev/x: STATUS is not answered")

    with open_rig_seeing(rendering, seed=2, realtime=False, camera="inside") as rig:
        monkeypatch.setattr(rig.board, "status", silent)
        flight = preflight(rig, PLAN, tmp_path)
    assert named(flight, "board").text == "LED board on /dev/x: STATUS is not answered"
    assert states(flight)["camera"] == "not done"


@IN_WORLD
def test_a_hot_board_is_reported(
    rendering: Rendering, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_check_rig, "_HOT_C", 20.0)
    flight = flown(rendering, PLAN, tmp_path)
    assert named(flight, "board").state == "warning"
    assert "let it cool down" in named(flight, "board").text


# The disk.


def test_free_space_for_the_recording_and_a_quarter_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda path: Usage(10**9, 0, 125_000_000))
    assert check_disk(tmp_path, 100_000_000).state == "ok"
    tight = check_disk(tmp_path, 100_000_001)
    assert tight.state == "failed"
    assert "125 MB free, 125 MB required (1.25 x the estimate)" in tight.text
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_named() -> None:
    found = check_disk(Path("/proc/no-such-folder/session"), 1)
    assert found.state == "failed"
    assert found.text.startswith("/proc: cannot write a file here")


def test_a_file_in_the_way_is_named(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("x")
    found = check_disk(tmp_path / "notes.txt" / "session", 1)
    assert found.state == "failed"
    assert found.text.startswith(f"{tmp_path / 'notes.txt'}: cannot write a file here")


def test_a_disk_that_refuses_to_flush_or_returns_other_data(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flush = os.fsync

    def refuse(descriptor: int) -> None:
        # Folders can be flushed here, files cannot.
        if stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError(5, "Input/output error")
        flush(descriptor)

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", refuse)
        found = check_disk(tmp_path, 1)
        assert found.state == "failed"
        assert "Input/output error; the disk fails" in found.text
    with monkeypatch.context() as patched:
        patched.setattr("acquisition.preflights.rig.read_back", lambda path: b"something else")
        found = check_disk(tmp_path, 1)
        assert found.state == "failed"
        assert "differs from the data written" in found.text
    assert list(tmp_path.iterdir()) == []


# Checks of synthetic images.


def scene(sigma_px: float = 0.0, seed: int = 3) -> Float64:
    """Return a blurred random texture with a mean of 0.1 grey values per microsecond."""
    image = np.random.default_rng(seed).uniform(0.02, 0.18, (120, 160))
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px) if sigma_px else image, np.float64)


def frame(light: Float64, exposure_us: float, seed: int, gamma: float = 1.0) -> UInt16:
    grey = 64 + 4031 * (np.clip(light * exposure_us / 4031, 0, 1)) ** gamma
    grey += np.random.default_rng(seed).normal(0, 3.0, light.shape)
    return np.clip(np.rint(grey), 0, WHITE_DN).astype(np.uint16)


def trials(
    light: Float64, room: float = 0.0, gamma: float = 1.0, long_us: float = 10_000.0
) -> Trials:
    off = np.full(light.shape, room)
    half_us = long_us / 2
    return Trials(
        led=5,
        black=64.0,
        white_dn=WHITE_DN,
        lit=(frame(light + room, long_us, 1, gamma), frame(light + room, long_us, 2, gamma)),
        unlit=frame(off, long_us, 3, gamma),
        half=frame(light + room, half_us, 4, gamma),
        half_unlit=frame(off, half_us, 5, gamma),
        lit_us=long_us,
        half_us=half_us,
    )


@pytest.mark.parametrize(
    ("gamma", "state"),
    [
        pytest.param(1.0, "ok", id="linear"),
        pytest.param(0.95, "warning", id="slightly-bent"),
        pytest.param(0.45, "failed", id="display-gamma"),
    ],
)
@pytest.mark.parametrize("room", [0.0, 0.01])
def test_a_camera_with_gamma(gamma: float, state: str, room: float) -> None:
    found = check_response(trials(scene(), room, gamma))
    assert found.state == state
    assert "LED 5" in found.text


def test_a_camera_that_brightens_short_exposures_by_itself() -> None:
    made = trials(scene())
    found = check_response(replace(made, half=frame(scene(), 10_000.0, 8)))
    assert found.state == "failed"
    assert "auto gain" in found.text


@pytest.mark.parametrize(
    ("long_us", "said"),
    [pytest.param(1e6, "saturated", id="bright"), pytest.param(10.0, "too little", id="dark")],
)
def test_a_response_that_cannot_be_measured(long_us: float, said: str) -> None:
    found = check_response(trials(scene(), long_us=long_us))
    assert found.state == "not done"
    assert said in found.text


def test_detail_is_independent_of_noise() -> None:
    rows, columns = np.mgrid[:200, :200]
    ramp = 500.0 + 8 * rows + 8 * columns
    noise = np.random.default_rng(1)
    fine = noise.normal(1000, 100, (200, 200))
    for sigma_dn in (0.0, 10.0):
        for image, wanted in ((ramp, 1 / 16), (fine, 1.0)):
            one, other = (
                np.rint(image + noise.normal(0, sigma_dn, image.shape)).astype(np.uint16)
                for _ in range(2)
            )
            assert detail(one, other)[0] == pytest.approx(wanted, rel=0.1)


def test_focus() -> None:
    assert check_focus(trials(scene())).state == "ok"
    blurred = check_focus(trials(scene(sigma_px=5)))
    assert blurred.state == "warning"
    assert "focus the lens" in blurred.text
    empty = check_focus(trials(np.full((120, 160), 0.1)))
    assert empty.state == "warning"
    assert "nothing to focus on" in empty.text


@IN_WORLD
def test_a_simulated_lens_out_of_focus_is_reported(rendering: Rendering, tmp_path: Path) -> None:
    planes = [cv2.GaussianBlur(plane, (0, 0), 5.0) for plane in rendering.planes]
    blurred = replace(rendering, planes=np.stack(planes))
    assert states(flown(blurred, PLAN, tmp_path))["focus"] == "warning"
    assert states(flown(rendering, PLAN, tmp_path))["focus"] == "ok"


@pytest.mark.parametrize(
    ("room", "state", "share"),
    [
        pytest.param(0.0, "ok", 0.0, id="dark"),
        pytest.param(0.001, "ok", 0.01, id="dim"),
        pytest.param(0.005, "warning", 0.05, id="bright"),
        pytest.param(0.1, "warning", 1.0, id="like-the-LED"),
    ],
)
def test_light_in_the_room(room: float, state: str, share: float) -> None:
    found = check_room(trials(scene(), room))
    assert found.state == state
    assert found.values["share"] == pytest.approx(share, abs=0.01 + share / 20)


def test_an_led_without_light_fails() -> None:
    assert check_room(trials(np.zeros((120, 160)), 0.02)).state == "failed"


def test_the_longest_and_the_shortest_bracket_are_judged() -> None:
    def shot(exposure_us: float) -> tuple[float, UInt16]:
        return exposure_us, frame(scene(), exposure_us, 1)

    def state(*exposures_us: float, limit: float = 1.0) -> str:
        frames = [shot(exposure_us) for exposure_us in exposures_us]
        return check_exposure(frames, 64.0, WHITE_DN, limit).state

    assert state(15_000) == "ok"
    assert state(60_000, 1000) == "ok"  # the long one is saturated, the short one is not
    assert state(60_000, 1000, limit=0.1) == "failed"
    assert state(60_000, 50_000) == "warning"
    assert state(1000, 100) == "warning"


def test_steadiness_is_relative_to_the_light() -> None:
    off = frame(np.zeros((120, 160)), 1000, 9)

    def steady(factors: list[float]) -> str:
        shots = [frame(scene() * f, 1000, n) for n, f in enumerate(factors)]
        return check_steadiness(2, shots, off, 1000.0).state

    assert steady([1.0, 1.0, 1.0, 1.0]) == "ok"
    assert steady([1.0, 1.05, 0.96, 1.02]) == "warning"
    assert steady([0.0, 0.0, 0.0]) == "not done"
