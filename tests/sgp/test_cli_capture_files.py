"""Compacting, exporting and importing sessions, as an operator does."""

import json
import os
import shutil
import signal
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.io import savemat

from acquisition import Session, read_image, read_lights, write_png
from tests.cases import cases
from tests.sgp.small_rig import CAPTURE, interrupted


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """A simulated session with dark frame, near lights, mask and true normals."""
    from sgp.app import build, run

    folder = tmp_path_factory.mktemp("made") / "coin"
    words = ("simulate", "coin", "--out", str(folder), "--size", "96x80", "--led-count", "6")
    assert run(build(), [*words, "--seed", "3"]) == 0
    return folder


@pytest.fixture
def session(made, tmp_path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "coin"))


def lights_of(session: Path) -> Path:
    return session / "derived" / "truth" / "lights.json"


def lit(folder: Path) -> dict[int, np.ndarray]:
    return {f.led: f.read() for f in Session.open(folder).frames if f.role == "light"}


def same(folder: Path, other: Path) -> None:
    one, two = lit(folder), lit(other)
    assert list(one) == list(two)
    for led in one:
        np.testing.assert_array_equal(one[led], two[led])


def test_compacting_a_session(sgp, session, made):
    metrics = sgp("capture", "compact", session, "--json").figures()
    assert (metrics["frames"], metrics["compacted"], metrics["complete"]) == (7, 7, True)
    assert metrics["ratio"] > 1.3
    assert metrics["bytes_after"] == sum(f.stat().st_size for f in (session / "frames").iterdir())
    assert "intact and complete" in sgp("capture", "verify", session).ok().out
    same(made, session)
    assert "0 of 7 frames compacted" in sgp("capture", "compact", session).ok().out


def test_a_damaged_session_is_not_compacted(sgp, session):
    frame = session / "frames" / "L03_E0.tif"
    data = bytearray(frame.read_bytes())
    data[-1] ^= 1
    frame.write_bytes(data)
    assert "L03_E0.tif: was changed since it was recorded" in sgp(
        "capture", "compact", session
    ).error_line(4)
    assert sgp("capture", "compact", session / "none").code == 2


@pytest.mark.parametrize("layout", ["diligent", "lp", "alicevision"])
def test_export_and_import_give_the_same_pixels_and_lights(sgp, session, tmp_path, layout):
    out, back = tmp_path / "out", tmp_path / "back"
    words = ("--format", layout, "--out", out, "--lights", lights_of(session))
    assert sgp("capture", "export", session, *words, "--json").figures()["images"] == 6
    record = json.loads((out / "export.json").read_text())
    assert record["parameters"]["layout"] == layout
    assert record["metrics"]["subtracted"] == "nothing"
    assert str(session / "frames" / "L00_E0.tif") in record["inputs"]
    assert any("positions" in warning for warning in record["warnings"])
    assert sgp("capture", "import", out, "--out", back).ok().err == "", "there must be no warnings"
    same(session, back)
    lights, expected = Session.open(back).lights, read_lights(lights_of(session))
    assert lights is not None
    np.testing.assert_array_equal(lights.positions_mm, expected.positions_mm)
    np.testing.assert_array_equal(lights.intensities, expected.intensities)
    assert Session.open(back).manifest.object == "coin"


def test_normals_of_an_export_are_as_good_as_those_of_the_session(sgp, session, tmp_path):
    """With linear values another program needs neither black level nor dark frame."""
    lights = lights_of(session)
    words = ("--format", "diligent", "--values", "linear", "--lights", lights)
    answer = sgp("capture", "export", session, *words, "--out", tmp_path / "out", "--json").ok()
    assert json.loads(answer.out)["metrics"]["subtracted"] == "dark frames"
    errors = []
    for source, given in ((session, lights), (tmp_path / "out", None)):
        extra = ["--distant"] + ([] if given is None else ["--lights", given])
        answer = sgp(
            "normals", source, *extra, "--out", tmp_path / f"n{len(errors)}", "--force", "--json"
        ).ok()
        errors.append(json.loads(answer.out)["metrics"]["mae_deg"])
    assert errors[1] == pytest.approx(errors[0], abs=0.2)


def test_an_exr_stack_has_every_frame(sgp, session, tmp_path):
    sgp("capture", "export", session, "--format", "exr", "--out", tmp_path / "out").ok()
    assert len(list((tmp_path / "out").glob("*.exr"))) == 7
    stored = read_image(tmp_path / "out" / "L02_E0.exr")
    np.testing.assert_array_equal(stored, lit(session)[2].astype(np.float32))
    assert "export the session as lp, diligent or alicevision" in sgp(
        "capture", "import", tmp_path / "out", "--out", tmp_path / "back"
    ).error_line(4)
    assert not (tmp_path / "back").exists()


def test_an_export_replaces_only_an_earlier_one_and_only_with_force(sgp, session, tmp_path):
    out, lights = tmp_path / "out", lights_of(session)
    words = ("capture", "export", session, "--out", out, "--lights", lights, "--format")
    assert sgp(*words, "lp").code == 0
    (out / "mine.txt").write_text("keep")
    assert "--force" in sgp(*words, "diligent").error_line(2)
    assert (out / "lights.lp").exists()
    assert sgp(*words, "diligent", "--bracket", 7, "--force").code == 4
    assert (out / "lights.lp").exists(), "a failed command must not delete files"
    assert sgp(*words, "diligent", "--force").code == 0
    assert not (out / "lights.lp").exists()
    assert (out / "filenames.txt").exists()
    assert (out / "mine.txt").read_text() == "keep"


@cases(
    ("words", "code", "message"),
    {
        "no-lights": (["--format", "lp"], 4, "no lights are known"),
        "unknown-layout": (["--format", "gif"], 2, "gif"),
        "bracket": (["--format", "exr", "--bracket", "-1"], 2, "bracket"),
        "no-file": (["--format", "lp", "--lights", "none.lp"], 2, "none.lp"),
        "no-layout": ([], 2, "--format"),
    },
)
def test_impossible_exports(sgp, session, tmp_path, words, code, message):
    assert message in sgp(
        "capture", "export", session, "--out", tmp_path / "out", *words
    ).error_line(code)
    assert not (tmp_path / "out").exists()


def test_an_export_never_goes_into_the_session(sgp, session):
    words = ("capture", "export", session, "--format", "exr", "--out")
    assert sgp(*words, session / "frames" / "x").code == 2
    assert sgp(*words, session, "--force").code == 2
    assert sgp("capture", "verify", session).code == 0


def test_texts_are_stored_in_the_session_and_in_exports(sgp, recording, tmp_path):
    texts = {"object-name": "Ball", "operator": "Ada", "place": "Rome", "rights": "CC0"}
    options = [word for name, text in texts.items() for word in (f"--{name}", text)]
    lights = recording.parent / "lights.json"
    words = ("capture", "import", recording, "--lights", lights, "--out", tmp_path / "s")
    assert sgp(*words, *options).code == 0
    manifest = Session.open(tmp_path / "s").manifest
    assert (manifest.object, manifest.operator) == ("Ball", "Ada")
    assert (manifest.place, manifest.rights) == ("Rome", "CC0")
    words = ("capture", "export", tmp_path / "s", "--format", "lp", "--out", tmp_path / "out")
    assert sgp(*words).code == 0
    assert sgp("capture", "import", tmp_path / "out", "--out", tmp_path / "b").code == 0
    assert Session.open(tmp_path / "b").manifest.rights == "CC0"


def test_near_lights_from_elsewhere_come_in_without_json(sgp, tmp_path):
    """Lights and camera as near_ps has them, in OpenCV's axes, with an ambient frame."""
    folder = tmp_path / "near"
    folder.mkdir()
    for number in range(3):
        write_png(folder / f"raw_{number}.png", np.full((6, 8), 9000 + number, np.uint16))
    write_png(folder / "raw_ambient.png", np.full((6, 8), 1000, np.uint16))
    positions = np.array([[100.0, 0, 0], [0, 100, 10], [-70, -70, 5]])
    savemat(folder / "light.mat", {"S": positions, "mu": np.ones((3, 1))})
    (folder / "K.txt").write_text("800 0 4\n0 800 3\n0 0 1\n")
    words = ["capture", "import", folder, "--lights", folder / "light.mat", "--out"]
    assert "add --camera" in sgp(*words, tmp_path / "out").err
    words[3:3] = ["--camera", folder / "K.txt"]
    assert "add --working-distance-mm" in sgp(*words, tmp_path / "out").err
    answer = sgp(*words, tmp_path / "out", "--working-distance-mm", 500, "--json").ok()
    notices = {notice["code"]: notice["text"] for notice in json.loads(answer.out)["notices"]}
    assert set(notices) == {"light-axes", "reference-frames-found", "lights-matched-by-order"}
    assert "Y down, Z away from the camera" in notices["light-axes"]
    session = Session.open(tmp_path / "out")
    assert session.camera_model.working_distance_mm == 500
    expected = positions * [1, -1, -1] + [0, 0, 500]
    np.testing.assert_allclose(session.lights.positions_mm, expected)
    assert [frame.role for frame in session.frames].count("ambient") == 1
    assert (
        "requires a calibration"
        in sgp(
            "capture", "import", folder, "--light-axes", "opengl", "--out", tmp_path / "other"
        ).err
    )


def tethered(folder: Path, times: list[float]) -> Path:
    folder.mkdir(exist_ok=True)
    for number, at in enumerate(times):
        path = folder / f"IMG_{number:04d}.png"
        write_png(path, np.full((8, 10), 100 * number + 7, np.uint16))
        stamp = 1_700_000_000 * 10**9 + round(at * 1e9)
        os.utime(path, ns=(stamp, stamp))
    return folder


@pytest.mark.usefixtures("world")
def test_watching_a_folder(sgp, tmp_path):
    folder, out = tethered(tmp_path / "in", [0, 2, 4, 8, 10, 12]), tmp_path / "out"
    words = ("capture", "import", folder, "--watch", "--led-count", 7, "--out", out)
    answer = sgp(*words, "--timeout-s", 1.5, "--interval-s", 2, "--operator", "Ada", "--json")
    assert answer.code == 4, answer.err
    assert json.loads(answer.out)["metrics"]["missing"] == ["L03_E0.tif"]
    assert "1 image is missing between IMG_0002.png and IMG_0003.png" in answer.err
    assert "IMG_0003.png is L04_E0" in answer.err
    shutil.copy(folder / "IMG_0000.png", folder / "L03.png")
    sgp(*words, "--timeout-s", 20).ok()
    assert sgp("capture", "verify", out).code == 0
    assert Session.open(out).manifest.operator == "Ada"
    assert sgp(*words).code == 4, "a complete session is not continued"


@pytest.mark.usefixtures("world")
@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (("--plan", "plan.toml"), [("dark", None), ("light", 2), ("light", 0)]),
        (("--leds", "5-4, 9"), [("light", 5), ("light", 4), ("light", 9)]),
    ],
    ids=["plan", "listed LEDs"],
)
def test_watching_for_planned_shots(sgp, tmp_path, monkeypatch, options, expected):
    monkeypatch.chdir(tmp_path)
    Path("plan.toml").write_text("leds = [2, 0]\nexposures_us = [500.0]\n")
    folder = tethered(tmp_path / "in", [0, 2, 4])
    words = ("capture", "import", folder, "--watch", *options, "--out", tmp_path / "out")
    assert sgp(*words, "--interval-s", 2, "--timeout-s", 20).code == 0
    frames = Session.open(tmp_path / "out").frames
    assert [(frame.role, frame.led) for frame in frames] == expected


def test_ctrl_c_ends_a_watch_and_the_same_command_continues(sgp, tmp_path):
    folder, out = tethered(tmp_path / "in", [0, 2, 4, 6, 8, 10]), tmp_path / "out"
    words = ["import", folder, "--watch", "--led-count", "7", "--out", out]
    message = interrupted([*CAPTURE, *words], out / "frames" / "L05_E0.tif")
    assert "run the same command again to continue" in message
    tethered(folder, [0, 2, 4, 6, 8, 10, 12])
    assert sgp("capture", *words, "--timeout-s", 20).code == 0
    assert sgp("capture", "verify", out).code == 0


@pytest.mark.slow
def test_ctrl_c_while_a_raw_file_is_awaited_loses_nothing(sgp, tmp_path):
    folder, out = tmp_path / "in", tmp_path / "out"
    folder.mkdir()

    def shoot(number):
        pixels = np.random.default_rng(number).integers(0, 256, (40, 48), np.uint8)
        cv2.imwrite(str(folder / f"IMG_{number:04}.JPG"), pixels)

    shoot(0)
    words = ["import", str(folder), "--watch", "--led-count", "3", "--out", str(out)]
    process = subprocess.Popen(
        [*CAPTURE, *words],
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"NUMBA_NUM_THREADS": "1"},
    )
    assert "waits 10 s for a camera RAW file" in process.stderr.readline()
    process.send_signal(signal.SIGINT)
    _, message = process.communicate(timeout=100)
    assert process.returncode == 130, message
    assert "nothing was recorded yet; run the same command again to continue" in message
    assert "Traceback" not in message
    assert not out.exists()
    shoot(1)
    # Without a RAW file, the JPEGs count when the time is over.
    assert sgp("capture", *words, "--timeout-s", 0.5).code == 4
    shoot(2)
    assert sgp("capture", *words, "--timeout-s", 20).code == 0
    session = Session.open(out)
    assert [(frame.led, frame.line.origin) for frame in session.frames] == [
        (number, f"IMG_{number:04}.JPG") for number in range(3)
    ]


@cases(
    ("words", "message"),
    {
        "no-shots": (["--watch"], "requires either --leds, --led-count or --plan"),
        "both": (
            ["--watch", "--led-count", "3", "--plan", "p.toml"],
            "either --leds, --led-count or --plan",
        ),
        "not-watching": (["--led-count", "3"], "--led-count requires --watch"),
        "list-not-watching": (["--leds", "0-2"], "--leds requires --watch"),
        "old": (["--watch", "--leds", "3"], "--leds 3 is ambiguous: write --led-"),
        "twice": (["--watch", "--leds", "0-2,1"], "LED 1 is listed twice"),
        "list-and-count": (["--watch", "--leds", "0-2", "--led-count", "3"], "give only one"),
        "interval": (["--interval-s", "3"], "--interval-s requires --watch"),
        "no-time": (["--watch", "--led-count", "3", "--no-gaps", "--interval-s", "2"], "--no-gaps"),
        "no-leds": (["--watch", "--led-count", "0"], "led-count"),
        "mask": (["--watch", "--led-count", "3", "--mask", "m.png"], "--mask"),
        "timeout": (["--watch", "--led-count", "3", "--timeout-s", "0"], "timeout"),
    },
)
def test_impossible_watches(sgp, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    for name in ("p.toml", "m.png"):
        (tmp_path / name).touch()
    folder = tethered(tmp_path / "in", [0])
    assert message in sgp(
        "capture", "import", folder, "--out", tmp_path / "out", *words
    ).error_line(2)
    assert not (tmp_path / "out").exists()


def test_a_watch_for_other_shots_is_refused_and_does_not_ask_to_be_tried_again(sgp, tmp_path):
    folder = tethered(tmp_path / "in", [0, 2, 4])
    words = ("capture", "import", folder, "--watch", "--out", tmp_path / "out", "--timeout-s", 2)
    answer = sgp(*words, "--led-count", 4)
    assert answer.code == 4
    assert "INCOMPLETE, 1 of 4 shots missing, first L03_E0.tif" in answer.out
    assert "frames    3, 0 rejected" in answer.out
    verified = sgp("capture", "verify", tmp_path / "out")
    assert "incomplete, 3 frames are intact, but the session was not finished" in verified.out
    assert "not started by watching a folder for these shots" in sgp(
        *words, "--led-count", 5
    ).error_line(4)


def test_a_watch_never_writes_into_a_folder_with_other_files(sgp, tmp_path):
    folder = tethered(tmp_path / "in", [0])
    words = ("capture", "import", folder, "--watch", "--led-count", 1, "--out")
    assert sgp(*words, folder).code == 2
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "x").write_text("")
    assert sgp(*words, tmp_path / "other").code == 2
