"""Names that are not UTF-8, as arguments and in folders: a message or a result, never a crash."""

import json
import os
import shutil
import sys
from pathlib import Path

import pytest

from acquisition import read_image, verify_session, write_lights, write_png
from tests.quick_sample import quick
from tests.sgp.conftest import ball, ring_lights

BAD = os.fsdecode(b"caf\xe9")


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A folder in which files and folders with bad names can be created."""
    try:
        (tmp_path / BAD).mkdir()
    except OSError:
        pytest.skip("this file system accepts only names in UTF-8")
    return tmp_path


@pytest.fixture
def session(sgp, recording, place) -> Path:
    """A session that contains a folder with a bad name."""
    lights = place / "lights.json"
    out = place / "session"
    assert sgp("capture", "import", recording, "--lights", lights, "--out", out).code == 0
    (out / BAD).mkdir()
    return out


def in_bad_folder(recording: Path) -> list[Path]:
    """Return sources with a bad name of the folder, the images, the mask or the table."""
    place = recording.parent
    shutil.copytree(recording, place / BAD, dirs_exist_ok=True)
    images = Path(shutil.copytree(recording, place / "images"))
    for number, path in enumerate(sorted(images.iterdir())):
        path.rename(images / f"{BAD}.{number}.png")
    masked = Path(shutil.copytree(recording, place / "masked"))
    write_png(masked / "x.mask.png", ball()[1].astype("u1") * 255)
    (masked / "x.mask.png").rename(masked / f"{BAD}.mask.png")
    return [place / BAD, images, masked, place / BAD / "none", place / f"{BAD}.png"]


@pytest.mark.slow
@pytest.mark.parametrize("as_json", quick([False, True], every=2), ids=["text", "json"])
def test_sources_that_image_libraries_cannot_open(sgp, recording, place, as_json):
    json_too = ["--json"] if as_json else []
    for number, source in enumerate(in_bad_folder(recording)):
        out = place / f"out{number}"
        lights = ("--lights", place / "lights.json")
        for words in (
            ("normals", source, *lights, "--out", out),
            ("run", source, *lights, "--out", out),
            ("capture", "import", source, *lights, "--out", out),
            ("calibrate", "spheres", source, "--out", place / "l.json"),
            ("calibrate", "flat", source, *lights, "--out", out),
            ("calibrate", "sensor", source, "--out", out),
            ("surface", source, "--out", out),
            ("curvature", source, "--out", out),
            ("export", source, "--out", out),
            ("compare", source, source),
            ("merge", source, "--out", out),
            ("detail", "separate", source, "--out", out),
            ("project", source, "--out", out),
            ("capture", "verify", source),
            ("capture", "info", source),
            ("capture", "compact", source),
        ):
            answer = sgp(*words, *json_too)
            assert answer.code in (2, 4), (words, answer)
            assert str(source).encode("utf-8", "backslashreplace").decode() in answer.err
            assert answer.err.count("error: ") == 1
            if as_json:
                assert json.loads(answer.out)["exit_code"] == answer.code
            assert not out.exists()


@pytest.mark.slow
def test_files_that_need_no_image_library_may_have_any_name(sgp, recording, session, place):
    """Tables and lights have such names; records contain names that can be read back."""
    table = recording / f"{BAD}.lp"
    write_lights(place / "t.lp", ring_lights())
    rows = (place / "t.lp").read_text().splitlines()
    named = [f"ball.{n}.png {row.split(maxsplit=1)[1]}" for n, row in enumerate(rows[1:])]
    table.write_text("\n".join([rows[0], *named, ""]))
    lights = place / f"{BAD}.json"
    shutil.copy(place / "lights.json", lights)
    for number, words in enumerate(
        [("run", table), ("normals", session, "--lights", lights), ("normals", table, "--json")]
    ):
        out = place / f"out{number}"
        sgp(*words, "--out", out).ok()
        record = json.loads(next(out.glob("[ns]*.json")).read_text(encoding="utf-8"))
        assert any(os.path.exists(name) and BAD in name for name in record["inputs"])
    assert read_image(place / "out0" / "overview.png").ndim == 3
    assert sgp("capture", "verify", session).code == 0
    assert sgp("capture", "compact", session).code == 0
    assert verify_session(session).ok
    for layout in ("diligent", "lp", "exr", "alicevision"):
        words = ("capture", "export", session, "--format", layout, "--out", place / layout)
        assert sgp(*words).code == 0


def test_outputs_are_refused_before_the_work(sgp, recording, session, place):
    out = place / BAD / "out"
    for words in (
        ("normals", recording, "--lights", place / "lights.json", "--out", out),
        ("run", recording, "--lights", place / "lights.json", "--out", out),
        ("capture", "export", session, "--format", "lp", "--out", out),
        ("capture", "import", recording, "--out", out),
        ("capture", "info", session, "--sheet", out.with_suffix(".png")),
        ("calibrate", "spheres", recording, "--out", out.with_suffix(".json")),
        ("calibrate", "flat", recording, "--lights", place / "lights.json", "--out", out),
        ("calibrate", "sensor", recording, "--out", out),
        ("simulate", "coin", "--out", out),
        ("simulate", "list", "--sheet", out.with_suffix(".png")),
        ("rig", "snap", "--rig", "simulated", "--out", out.with_suffix(".tif")),
        ("demo", "--out", out),
    ):
        assert "the name is not UTF-8: choose another name" in sgp(*words).error_line(2)


def test_words_that_are_not_utf_8(sgp, recording, place):
    for words in (
        (BAD,),
        ("capture", BAD),
        (f"--{BAD}",),
        ("normals", f"--{BAD}"),
        ("normals", recording, "--method", BAD, "--out", place / "out"),
        ("rig", "check", "--rig", BAD),
        ("rig", "off", "--rig", f"{BAD}.toml"),
        ("capture", "plan", BAD),
        ("simulate", BAD, "--out", place / "out"),
    ):
        assert "caf\\udce9" in sgp(*words).error_line(2)
    for option in ("--operator", "--object-name"):
        words = ("capture", "import", recording, option, BAD, "--out", place / "out")
        assert "the text is not UTF-8: enter it again" in sgp(*words).error_line(4)


@pytest.mark.parametrize("name", quick(["$a^", "100$ \\frac", "a$b$c", "日本"], every=4))
def test_names_are_drawn_as_they_are(sgp, recording, place, name, recwarn):
    """A dollar sign does not start a formula."""
    source = Path(shutil.copytree(recording, place / name))
    lights = ("--lights", place / "lights.json")
    assert sgp("run", source, *lights, "--out", place / "out").code == 0
    glyphs = [str(warning.message) for warning in recwarn]
    assert all("missing from font" in text for text in glyphs)


@pytest.mark.slow
def test_a_stdout_of_another_encoding(recording, place):
    """Old terminals have such encodings; this runs in a separate process."""
    import subprocess

    source = shutil.copytree(recording, place / "日本")
    words = ["normals", source, "--lights", place / "lights.json", "--out", place / "日本-out"]
    done = subprocess.run(
        [sys.executable, "-P", "-c", "from sgp import main; main()", *words, "--json"],
        capture_output=True,
        env={**os.environ, "PYTHONIOENCODING": "latin-1"},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    outputs = json.loads(done.stdout.decode("latin-1"))["outputs"]
    assert Path(outputs["normals"]).is_file()
