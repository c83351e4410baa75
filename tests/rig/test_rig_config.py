"""Rig files, and rigs found by name."""

import re
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path

import pytest

import rig.config.drivers
from rig import Mounting, RigConfig, RigConfigError, RigNotFoundError, open_rig, read_rig_config
from rig.config import rig_names

POSITIONS = [(10.0 * led, -5.0, 300.25) for led in range(24)]
WHOLE = f"""
name = "dome"
driver = "bench"
leds = 24
settle_ms = 3.5
dead_leds = [4, 9]
led_positions_mm = {[list(position) for position in POSITIONS]}
led_positions_sigma_mm = 2.5
trigger = "board"
exposure_active = true
frame_period_ms = 50
frame_timeout_s = 1.5

[mounting]
rotation_deg = 270
mirror = true

[options]
port = "/dev/ttyACM0"
"""


def test_a_complete_rig_file(tmp_path: Path):
    (tmp_path / "rig.toml").write_text(WHOLE)
    config = read_rig_config(tmp_path / "rig.toml")
    assert config == RigConfig(
        name="dome",
        driver="bench",
        leds=24,
        settle_ms=3.5,
        dead_leds=(4, 9),
        led_positions_mm=POSITIONS,
        led_positions_sigma_mm=2.5,
        trigger="board",
        exposure_active=True,
        frame_period_ms=50.0,
        frame_timeout_s=1.5,
        mounting=Mounting(rotation_deg=270, mirror=True),
        options={"port": "/dev/ttyACM0"},
    )


def test_defaults_of_a_short_rig_file(tmp_path: Path):
    (tmp_path / "rig.toml").write_text('name = "dome"\ndriver = "bench"\n')
    config = read_rig_config(tmp_path / "rig.toml")
    assert (config.leds, config.trigger, config.exposure_active) == (36, "software", False)
    assert config.mounting == Mounting()
    assert (config.led_positions_mm, config.led_positions_sigma_mm) == ((), 10.0)


BAD_FILES = {
    "key": (WHOLE.replace("leds", "leads"), "unknown key 'leads'; known are"),
    "no LED": (WHOLE.replace("24", "0"), "'leds': .* greater than or equal to 1"),
    "type": (WHOLE.replace("24", '"x"'), "'leds': .* valid integer"),
    "NaN": (WHOLE.replace("3.5", "nan"), "'settle_ms': .* finite"),
    "dead": (WHOLE.replace("9]", "24]"), "dead LED 24 is not one of 0 to 23"),
    "positions": (WHOLE.replace("[0.0, -5.0, 300.25], ", ""), "has 23 positions for 24"),
    "all below": (re.sub(r"300\.25|300\.0", "-300.0", WHOLE), "no LED above the working plane"),
    "number as text": (WHOLE.replace("3.5", '"3.5"'), "'settle_ms': .* valid number"),
    "number as truth": (WHOLE.replace("3.5", "true"), "'settle_ms': .* valid number"),
    "truth as text": (re.sub("(exposure_active =) true", r'\1 "no"', WHOLE), "valid boolean"),
    "trigger": (WHOLE.replace('"board"', '"line"'), "'trigger'"),
    "rotation": (WHOLE.replace("270", "45"), r"'mounting.rotation_deg'"),
    "mirror": (WHOLE.replace("mirror", "mirrored"), "unknown key 'mounting.mirrored'"),
    "missing": (WHOLE.replace('driver = "bench"', ""), "'driver' is missing"),
    "not TOML": ("name = ", "is not TOML"),
}


@pytest.mark.parametrize(("text", "said"), BAD_FILES.values(), ids=BAD_FILES)
def test_a_bad_rig_file_gets_one_line(tmp_path: Path, text, said):
    path = tmp_path / "rig.toml"
    path.write_text(text)
    with pytest.raises(RigConfigError, match=said) as error:
        open_rig(str(path))
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_bytes_that_are_not_text(tmp_path: Path):
    (tmp_path / "rig.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(RigConfigError, match="is not TOML"):
        read_rig_config(tmp_path / "rig.toml")


@pytest.mark.parametrize("name", ["rig.toml", "RIG.TOML", "sub/bench", "sub/simulated"])
def test_a_missing_file(tmp_path: Path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RigNotFoundError, match="no such rig file"):
        open_rig(name)
    with pytest.raises(RigNotFoundError, match="no such rig file"):
        read_rig_config(tmp_path / name)


def test_a_folder_is_not_a_rig_file(tmp_path: Path):
    with pytest.raises(RigConfigError, match="a folder") as error:
        open_rig(str(tmp_path))
    assert not isinstance(error.value, RigNotFoundError)


def test_an_unknown_name_lists_the_known_ones():
    assert "simulated" in rig_names()
    with pytest.raises(RigNotFoundError, match=r"called 'simulatd' .*known: .*simulated"):
        open_rig("simulatd")


def test_an_unknown_driver_in_a_file(tmp_path: Path):
    (tmp_path / "rig.toml").write_text('name = "dome"\ndriver = "benhc"\n')
    with pytest.raises(RigConfigError, match=r"no driver is called 'benhc' .*known: .*simulated"):
        open_rig(str(tmp_path / "rig.toml"))


@pytest.fixture
def drivers(monkeypatch):
    points = EntryPoints(
        [
            EntryPoint("echo", "builtins:dict", rig.config.drivers.DRIVERS),
            EntryPoint("broken", "no_such_module:open", rig.config.drivers.DRIVERS),
        ]
    )
    monkeypatch.setattr(
        rig.config.drivers, "entry_points", lambda group: points.select(group=group)
    )


@pytest.mark.usefixtures("drivers")
def test_the_driver_gets_the_configuration(tmp_path: Path):
    assert open_rig("echo") == dict(RigConfig(name="echo", driver="echo"))
    (tmp_path / "rig.toml").write_text(WHOLE.replace("bench", "echo"))
    assert open_rig(str(tmp_path / "rig.toml"))["options"]["port"] == "/dev/ttyACM0"


@pytest.mark.usefixtures("drivers")
def test_a_driver_that_does_not_load():
    with pytest.raises(RigConfigError, match=r"'broken' cannot be loaded .*no_such_module"):
        open_rig("broken")
