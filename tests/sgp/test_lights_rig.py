"""``--lights rig``: the LEDs at the positions of the rig file as lights."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import acquisition
from rig import RigConfig, read_rig_config
from sgp.cli.exit import UsageError
from sgp.cli.options import RIG_LIGHTS
from sgp.report import make_report
from sgp.rigs import given_lights

PLACES = [[300, 0, 300], [0, 310, 300], [-280, 0, 300], [0, -305, 310]]
GOLDEN = Path(__file__).parents[1] / "acquisition" / "golden_session_3"
NEWEST = GOLDEN.with_name("golden_session_4")


def rig_file(path: Path, name: str = "desk", *lines: str) -> Path:
    head = [f'name = "{name}"', 'driver = "simulated"', "leds = 4"]
    path.write_text("\n".join([*head, *lines]) + "\n")
    return path


def test_lights_of_a_rig(tmp_path: Path) -> None:
    file = rig_file(
        tmp_path / "r.toml", "desk", f"led_positions_mm = {PLACES}", "led_positions_sigma_mm = 2.5"
    )
    config = read_rig_config(file)
    lights = acquisition.value_files.lights_of_rig(config)
    assert lights.ids == ("L00", "L01", "L02", "L03")
    assert lights.positions_mm is not None
    assert lights.errors is not None
    assert (lights.positions_mm == PLACES).all()
    assert (lights.errors.covariances == 6.25 * np.eye(3)).all()
    assert (lights.intensities == 1).all()
    assert lights.calibrated is not None
    assert lights.calibrated.setup.rig == "desk"
    with pytest.raises(acquisition.DataError, match="desk has no led_positions_mm"):
        acquisition.value_files.lights_of_rig(RigConfig(name="desk", driver="bench"))
    given = given_lights(RIG_LIGHTS, [], file)
    assert (given.file, [one.code for one in given.lights.warnings]) == (file, ["lights-of-rig"])
    assert "2.5 mm" in given.lights.warnings[0].text


@pytest.mark.parametrize(
    ("name", "positions", "said"),
    [
        pytest.param("dome", True, "", id="the rig of the session"),
        pytest.param("desk", True, "recorded on the rig dome", id="another rig"),
        pytest.param("dome", False, "has no led_positions_mm", id="no positions"),
        pytest.param("", True, "the rig is not known", id="no rig"),
    ],
)
def test_the_rig_of_a_session(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, positions: bool, said: str
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    monkeypatch.delenv("SGP_RIG", raising=False)
    if name:
        lines = [f"led_positions_mm = {PLACES}"] if positions else []
        monkeypatch.setenv("SGP_RIG", str(rig_file(tmp_path / "r.toml", name, *lines)))
    # Sessions up to version 3 have no positions.
    if said:
        with pytest.raises(UsageError, match=said):
            given_lights(RIG_LIGHTS, [GOLDEN])
    else:
        assert len(given_lights(RIG_LIGHTS, [GOLDEN]).lights) == 4


def test_a_session_knows_the_positions_of_its_rig(tmp_path: Path) -> None:
    given = given_lights(RIG_LIGHTS, [NEWEST])
    assert given.lights.positions_mm is not None
    assert given.lights.positions_mm[:, 1].tolist() == [0, 10, 20, 30]
    assert "2.5 mm" in given.lights.warnings[0].text
    # A rig file that is given replaces them.
    other = rig_file(tmp_path / "r.toml", "desk", f"led_positions_mm = {PLACES}")
    assert given_lights(RIG_LIGHTS, [NEWEST], other).file == other


def test_a_folder_of_images_under_the_lights_of_a_rig(sgp, tmp_path: Path) -> None:
    """A flat card: the normals are toward the camera, and the record knows the rig file."""
    places = np.array(PLACES, float)
    strength = places[:, 2] / np.linalg.norm(places, axis=1)
    (tmp_path / "src").mkdir()
    for led, value in enumerate(strength):
        image = np.full((20, 30), round(40000 * value), np.uint16)
        cv2.imwrite(str(tmp_path / "src" / f"L{led:02d}.png"), image)
    cv2.imwrite(str(tmp_path / "mask.png"), np.full((20, 30), 255, np.uint8))
    file = rig_file(tmp_path / "r.toml", "desk", f"led_positions_mm = {PLACES}")
    words = ("--mask", tmp_path / "mask.png", "--distant", "--out", tmp_path / "out")
    code, _, err = sgp(
        "normals", tmp_path / "src", "--lights", "rig", "--rig", file, *words, "--json"
    )
    assert code == 0, err
    record = json.loads((tmp_path / "out" / "normals.json").read_text())
    assert str(file) in record["inputs"]
    assert (record["parameters"]["lights"], record["parameters"]["rig"]) == ("rig", str(file))
    image = cv2.imread(str(tmp_path / "out" / "normals.png"), cv2.IMREAD_UNCHANGED)
    assert np.abs(image[..., 2::-1] / 65535 * 2 - 1 - [0, 0, 1]).max() < 0.01
    # Its page does not look for a file `rig`.
    made = make_report([tmp_path / "out"], max_pixels=10_000)
    assert not any("not shown" in notice.text for notice in made.notices)
