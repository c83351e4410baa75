"""``sgp calibrate sensor`` on recordings of the simulated rig, and what uses its result."""

import json
import shutil

import numpy as np
import pytest

from acquisition import Lights, Session, read_image, read_source, verify_session, write_lights
from acquisition.value_files import read_sensor  # fmt: skip
from calibration import linear_stack

SENSOR = "{ prnu = 0.01, dsnu_e = 2.0, dark_current_e_per_s = 100.0, full_well_e = 9000.0 }"
CARD = f"""
ambient = 0.0
sensor = {SENSOR}
lens = {{ kind = "perspective", width = 200, height = 160, vignetting = 1.0 }}
board = {{ kind = "even", albedo = 0.8 }}
lights = {{ kind = "ring", count = 1, elevation_deg = 80, spread = 0 }}
"""
RIG = """
name = "card"
driver = "simulated"
leds = 1
options = { scene = "card.toml", realtime = false, camera = "inside" }
"""
TIMES_US = [*range(2500, 40001, 2500), 50_000]
PLAN = f'leds = "0-0"\nexposures_us = {TIMES_US}\nrepeats = 2\n'
OBJECT = f"""
name = "object"
driver = "simulated"
leds = 4
[options]
scene = "coin"
width = 64
height = 52
realtime = false
camera = "inside"
sensor = {SENSOR}
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with a recording of a card, and its calibration in sensor/."""
    folder = tmp_path_factory.mktemp("sensor")
    for name, text in (
        ("card.toml", CARD), ("rig.toml", RIG), ("plan.toml", PLAN), ("object.toml", OBJECT)
    ):  # fmt: skip
        (folder / name).write_text(text)
    return folder


@pytest.fixture
def here(place, monkeypatch, sgp):
    monkeypatch.chdir(place)
    if not (place / "card").exists():
        words = ("capture", "run", "card", "--rig", "rig.toml", "--plan", "plan.toml")
        assert sgp(*words, "--skip-check").code == 0
        answer = sgp("calibrate", "sensor", "card", "--out", "sensor").ok()
        (place / "lines.txt").write_text(answer.out)
        words = ("capture", "run", "bare", "--rig", "object.toml", "--skip-check")
        assert sgp(*words).code == 0
    return place


def test_a_recording_of_a_card_gives_the_sensor(sgp, here):
    record = json.loads((here / "sensor/calibrate-sensor.json").read_text())
    figures = record["metrics"]
    assert figures["electrons_per_dn"] == pytest.approx(2.5, rel=0.01)
    assert figures["read_noise_e"] == pytest.approx(2.5, rel=0.02)
    assert figures["full_well_e"] == pytest.approx(9000, rel=0.02)
    assert figures["prnu"] == pytest.approx(0.01, rel=0.05)
    assert figures["dark_current_e_per_s"] == pytest.approx(100, rel=0.03)
    assert figures["linearity_error"] < 0.001
    assert record["warnings"] == []
    assert read_image("sensor/sensor.png").shape[2] == 3
    made_by = json.loads((here / "sensor/sensor.json").read_text())["provenance"]
    assert len(made_by["inputs"]) == 3 * len(TIMES_US) + 3  # with files of the session
    assert record["outputs"] == {"sensor": "sensor.json", "picture": "sensor.png"}


def test_the_lines_name_what_was_found(sgp, here):
    lines = (here / "lines.txt").read_text()
    for text in ("e/DN at 0 dB", "limited by the pixel", "PRNU", "dark current", "+-"):
        assert text in lines
    line = sgp("calibrate", "sensor", "card", "--out", "sensor").error_line(2)
    assert "already contains files" in line
    assert "card" in sgp("calibrate", "sensor", "card", "--out", "card/derived2").error_line(2)


def test_a_session_stores_the_sensor(sgp, here):
    words = ("capture", "run", "owl", "--rig", "object.toml", "--skip-check")
    assert sgp(*words, "--sensor", "sensor/sensor.json").code == 0
    stored, measured = Session.open(here / "owl").sensor, read_sensor("sensor/sensor.json")
    assert stored == measured.noise_model()
    assert verify_session(here / "owl").ok
    source = read_source(here / "owl")
    assert source.black_level == pytest.approx(64, abs=0.1)
    assert linear_stack(source).noise.origin == "sensor"


def test_the_rig_file_names_the_sensor(sgp, here):
    (here / "bench").mkdir(exist_ok=True)
    rig = here / "bench/rig.toml"
    rig.write_text(OBJECT.replace("leds = 4", 'leds = 4\nsensor = "../sensor/sensor.json"'))
    words = ("capture", "run", "heron", "--rig", "bench/rig.toml", "--skip-check")
    assert sgp(*words).code == 0
    assert Session.open(here / "heron").sensor == read_sensor("sensor/sensor.json").noise_model()
    for value, text in (("lost.json", "lost.json"), ("../rig.toml", "JSON"), ("", "bench")):
        rig.write_text(OBJECT.replace("leds = 4", f'leds = 4\nsensor = "{value}"'))
        answer = sgp("capture", "run", "none", "--rig", "bench/rig.toml", "--skip-check")
        line = answer.error_line(answer.code)
        assert answer.code in (2, 4)
        assert text in line
        assert "`sensor` in bench/rig.toml names it" in line
        assert not (here / "none").exists()


def test_a_recording_without_a_sensor_gets_it_for_the_computation(sgp, here):
    directions = [[1.0, 0.0, 1.5], [0.0, 1.0, 1.5], [-1.0, 0.0, 1.5], [0.0, -1.0, 1.5]]
    write_lights("lights.json", Lights(directions=directions))
    words = ("normals", "bare", "--lights", "lights.json")
    sgp(*words, "--sensor", "sensor/sensor.json", "--out", "n").ok()
    record = json.loads((here / "n/normals.json").read_text())
    assert record["parameters"]["sensor"] == "sensor/sensor.json"
    assert "sensor/sensor.json" in record["inputs"]


def test_another_camera_and_gain_are_reported(sgp, here):
    text = (here / "sensor/sensor.json").read_text()
    other = text.replace('"serial": "virtual-camera"', '"serial": "4711"')
    (here / "other.json").write_text(other.replace('"gain_db": 0.0', '"gain_db": 6.0'))
    words = ("capture", "run", "third", "--rig", "object.toml", "--skip-check")
    answer = sgp(*words, "--sensor", "other.json").ok()
    assert "measured with camera 4711" in answer.err
    assert "measured at 6 dB, but the gain is 0 dB" in answer.err
    gain = Session.open(here / "third").sensor.electrons_per_dn
    assert gain == pytest.approx(read_sensor("sensor/sensor.json").electrons_per_dn.value * 10**0.3)


@pytest.mark.slow
def test_images_of_another_program_are_imported_with_the_plan(sgp, here):
    images = here / "tethered"
    images.mkdir()
    lines = map(json.loads, (here / "card/journal.jsonl").read_text().splitlines())
    files = [line["file"] for line in lines if line["kind"] == "frame"]
    for number, file in enumerate(files, 1):
        shutil.copy(here / "card" / file, images / f"IMG_{number:04}.tif")
    line = sgp("calibrate", "sensor", "tethered", "--out", "unplanned").error_line(4)
    assert "the exposure time is not known" in line
    words = ("capture", "import", "tethered", "--watch", "--plan", "plan.toml", "--out", "plain")
    assert sgp(*words).code == 0
    assert sgp("calibrate", "sensor", "plain", "--out", "of-images").code == 0
    # The camera reports exposure times with other digits than the plan.
    found, expected = read_sensor("of-images/sensor.json"), read_sensor("sensor/sensor.json")
    for name, figure in expected.figures.items():
        assert found.figures[name].value == pytest.approx(figure.value, rel=1e-4), name


def test_an_object_is_no_card(sgp, here):
    line = sgp("calibrate", "sensor", "bare", "--out", "few-sensor").error_line(5)
    assert "1 exposure, at least 5" in line
    assert not (here / "few-sensor").exists()


def test_a_frame_that_was_cut_off_is_named(sgp, here):
    frame = sorted((here / "card/frames").glob("L00*"))[3]
    whole = frame.read_bytes()
    frame.write_bytes(whole[: len(whole) // 2])
    try:
        line = sgp("calibrate", "sensor", "card", "--out", "cut").error_line(4)
    finally:
        frame.write_bytes(whole)
    assert frame.name in line
    assert not (here / "cut").exists()


@pytest.mark.parametrize(
    ("change", "text"),
    [
        pytest.param(lambda t: t.replace('"version": 1', '"version": 2'), "version 2", id="new"),
        pytest.param(lambda t: t.replace("sgp-sensor", "sgp-lights"), "format", id="lights"),
        pytest.param(lambda t: t[:300], "JSON", id="truncated"),
        pytest.param(lambda t: t.replace('"prnu":', '"pruno":'), "pruno", id="unknown key"),
        pytest.param(lambda t: t.replace('"prnu_sigma":', '"x":'), "prnu_sigma", id="no sigma"),
        pytest.param(lambda t: t.replace('"prnu": 0.', '"prnu": -0.'), "prnu", id="negative"),
        pytest.param(lambda t: t.replace('"prnu": 0.', '"prnu": NaN, "x": 0.'), "nan", id="NaN"),
        pytest.param(lambda t: t.replace('"bit_depth": 12', '"bit_depth": 10'), "10 bits", id="10"),
        pytest.param(
            lambda t: t.replace('"full_well_limit": "pixel",', ""), "full_well_limit", id="limit"
        ),
    ],
)
def test_files_that_are_no_sensor_are_named(sgp, here, change, text):
    (here / "bad.json").write_text(change((here / "sensor/sensor.json").read_text()))
    line = sgp("inspect", "bare", "--sensor", "bad.json").error_line(4)
    assert text in line
    assert "bad.json" in line or "bare" in line


def test_a_sensor_file_survives_a_round_trip(here):
    from acquisition.value_files import write_sensor

    first = read_sensor("sensor/sensor.json")
    write_sensor("copy.json", first)
    second = read_sensor("copy.json")
    assert second.figures == first.figures
    assert second.time_utc == first.time_utc
    assert second.setup.camera_serial == first.setup.camera_serial == "virtual-camera"
    assert second.noise_model(6.0) == first.noise_model(6.0)
    assert np.isclose(first.noise_model(20.0).electrons_per_dn, 0.25, rtol=0.01)
