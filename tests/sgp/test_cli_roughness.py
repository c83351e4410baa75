"""The command for roughness, on results of a simulated plate with a groove and a texture."""

import csv
import json

import numpy as np
import pytest

from acquisition import CameraModel, read_image, write_camera, write_exr, write_mask, write_png
from benchmarks.relief_fields import View, relief, seen, write_field
from processing import NormalMap, read_normals, write_normals
from processing.registration import Field
from sgp.app import build, run

PIXEL = 0.01
SIZE = 160


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """Return the surface of waves along y and of a groove along y with flanks of 16 pixels."""
    folder = tmp_path_factory.mktemp("plate")
    y, x = np.mgrid[:SIZE, :SIZE].astype(float)
    slope = 0.02 * np.cos(2 * np.pi * y / 16) * (x < 80)
    across = np.zeros_like(x)
    for place, sign in ((100, -1), (130, 1)):
        t = np.clip((x - place) / 16 + 0.5, 0, 1)
        across += sign * 0.05 * np.pi / 2 * np.sin(np.pi * t) / 16 / PIXEL
    normals = NormalMap.from_vectors(np.dstack([-across, slope, np.ones_like(x)]))
    write_normals(folder / "normals", normals)
    words = ["surface", folder / "normals", "--pixel-mm", PIXEL, "--smooth"]
    tokens = [str(word) for word in (*words, "--out", folder / "surface")]
    assert run(build(tokens), tokens) == 0
    return folder


def parameters(metrics, number=0):
    return {one["name"]: one for one in metrics["regions"][number]["parameters"]}


def test_areas_profiles_and_steps_in_one_table(sgp, result, tmp_path):
    out = tmp_path / "out"
    words = ("roughness", result, "--region", "waves=10,10,60,140", "--step", "across=75,80,155,80")
    answer = sgp(*words, "--line", "40,10,40,150,3", "--l-mm", "0", "--out", out)
    answer.ok()
    record = json.loads((out / "roughness.json").read_text())
    regions = record["metrics"]["regions"]
    assert [(one["name"], one["kind"]) for one in regions] == [
        ("waves", "area"),
        ("40,10,40,150,3", "profile"),
        ("across", "step"),
    ]
    wave = 1000 * 0.02 * 16 * PIXEL / (2 * np.pi)
    area = parameters(record["metrics"])
    assert area["Sq"]["value"] == pytest.approx(wave / np.sqrt(2), rel=0.1)
    assert area["Sq"]["sigma"] is None
    assert parameters(record["metrics"], 1)["RSm"]["value"] == pytest.approx(0.16, rel=0.01)
    assert parameters(record["metrics"], 2)["d"]["value"] == pytest.approx(-50, rel=0.01)
    with (out / "parameters.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["region"] for row in rows} == {one["name"] for one in regions}
    heights = read_image(out / "heights_0.exr")
    assert np.isfinite(heights).sum() == 60 * 140
    assert "error bars of the normals are not known" in answer.err


def test_limits_decide_with_the_uncertainty(sgp, result, tmp_path):
    limits = tmp_path / "limits.toml"
    limits.write_text('[[limit]]\nparameter = "Sq"\nmost = 0.001\n')
    answer = sgp("roughness", result, "--limits", limits)
    # Without an uncertainty, nothing is proven.
    assert "undecided" in answer.ok().out


def test_a_limit_holds_for_all_places_of_a_name(sgp, result, tmp_path):
    limits = tmp_path / "limits.toml"
    limits.write_text('[[limit]]\nparameter = "Sq"\nmost = 9\n')
    areas = "--region", "a =10,10,60,140", "--region", "b=20,20,40,40"
    words = ("roughness", result, *areas, "--line", "a=40,10,40,150", "--limits", limits)
    found = sgp(*words, "--l-mm", "0", "--json").figures()["limits"]
    assert [one["region"] for one in found] == ["a", "b"]


BAD = {
    "no surface": (("{empty}",), "has neither surface.json", 2),
    "region outside": (("{result}", "--region", "100,100,90,90"), "is not inside the image", 4),
    "region of text": (("{result}", "--region", "a=b"), "is neither x,y,w,h", 2),
    "same name": (("{result}", "--region", "a=1,1,50,50", "--region", "a=9,9,50,50"), "twice", 2),
    "small region": (
        ("{result}", "--region", "1,1,9,9", "--l-mm", "1"),
        "the smallest area is 1 mm",
        4,
    ),
    "fine filter": (("{result}", "--s-mm", "0.01"), "below what the images resolve", 4),
    "line of text": (("{result}", "--line", "1,2,3"), "give x0,y0,x1,y1", 2),
    "line outside": (
        ("{result}", "--line", "q=0,0,159,0,3"),
        "profile q: leaves the image of 160 x 160 pixels, whose last pixel is 159,159",
        4,
    ),
    "line without a length": (("{result}", "--line", "9,9,9,9"), "9,9,9,9: 1 pixel long", 4),
    "step on a plane": (("{result}", "--step", "q=100,9,100,50"), "step q: ", 5),
    "sphere of a plate": (("{result}", "--line", "1,2,100,5", "--form", "sphere"), "no sphere", 4),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input(sgp, result, tmp_path, name):
    words, message, code = BAD[name]
    (tmp_path / "empty").mkdir()
    places = {"result": result, "empty": tmp_path / "empty"}
    answer = sgp("roughness", *(word.format(**places) for word in words))
    assert message in answer.error_line(code)


def test_heights_in_pixels_are_refused(sgp, result, tmp_path):
    out = tmp_path / "surface"
    sgp("surface", result / "normals", "--out", out).ok()
    assert "the heights are in pixels" in sgp("roughness", out).error_line(2)


def test_parts_are_not_compared(sgp, result, tmp_path):
    """Two parts of a surface: the relative height of both is not known."""
    normals = read_normals(result / "normals").normal_map
    mask = np.ones((SIZE, SIZE), bool)
    mask[:, 100:104] = False
    write_normals(tmp_path / "normals", NormalMap.of_unit_vectors(normals.normals, mask))
    words = ("surface", tmp_path / "normals", "--pixel-mm", PIXEL, "--smooth")
    sgp(*words, "--out", tmp_path / "surface").ok()
    answer = sgp("roughness", tmp_path, "--json")
    assert "roughness-parts" in answer.codes()
    assert answer.figures()["regions"][0]["pixels"] == 100 * SIZE
    partly = sgp("roughness", tmp_path, "--region", "rim=80,20,24,40").ok()
    (text,) = (one for one in partly.err.splitlines() if "region rim" in one)
    assert "16.7% of region rim have no height" in text
    for option in ("--line", "--step"):
        line = sgp("roughness", tmp_path, option, "80,80,140,80").error_line(4)
        assert "crosses a hole or a jump" in line
    sgp("roughness", tmp_path, "--line", "110,20,110,150").ok()


def test_jumps_divide_parts(sgp, result, tmp_path):
    for file in (result / "surface").iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    jumps = np.zeros((SIZE, SIZE), np.uint8)
    jumps[:, 59] = 85
    write_png(tmp_path / "jumps.png", jumps)
    answer = sgp("roughness", tmp_path, "--json")
    assert "roughness-parts" in answer.codes()
    assert answer.figures()["regions"][0]["pixels"] == 100 * SIZE
    assert "crosses" in sgp("roughness", tmp_path, "--line", "20,80,90,80").error_line(4)


def test_jumps_that_are_gone_are_missed(sgp, tmp_path):
    vectors = np.tile([0.0, 0.0, 1.0], (60, 100, 1))
    vectors[:, 50, 0] = -3.0
    write_normals(tmp_path / "normals", NormalMap.from_vectors(vectors))
    words = ("surface", tmp_path / "normals", "--pixel-mm", PIXEL, "--discontinuity")
    sgp(*words, "--out", tmp_path / "surface").ok()
    (tmp_path / "surface" / "jumps.png").unlink()
    assert "jumps.png: is missing" in sgp("roughness", tmp_path).error_line(4)


def test_islands_and_masks(sgp, result, tmp_path):
    mask = np.zeros((SIZE, SIZE), bool)
    mask[10:150, 10:70] = True
    mask[60:80, 30:40] = False
    write_mask(tmp_path / "part.png", mask)
    answer = sgp("roughness", result, "--region", tmp_path / "part.png", "--json").figures()
    assert answer["regions"][0]["pixels"] == mask.sum()
    mask[:] = False
    mask[0, :2] = True
    write_mask(tmp_path / "corner.png", mask)
    line = sgp("roughness", result, "--region", tmp_path / "corner.png").error_line(4)
    assert "the smallest area is" in line


def test_heights_that_have_changed_are_refused(sgp, certain):
    file = certain / "surface" / "height.exr"
    write_exr(file, read_image(file) + np.float32(1))
    assert "height.exr: was changed" in sgp("roughness", certain).error_line(4)


@pytest.fixture
def certain(sgp, tmp_path):
    """Return a result with error bars."""
    folder = tmp_path / "certain"
    field = seen(relief((170, 190), 5), View(95, 85, 0.0), (120, 140), 0)[0]
    write_field(folder / "normals", field, pixel_mm=0.05)
    sigma = folder / "normals" / "normal_sigma_deg.exr"
    words = ("surface", folder / "normals", "--sigma", sigma, "--pixel-mm", "0.05", "--smooth")
    sgp(*words, "--out", folder / "surface").ok()
    return folder


def test_values_have_uncertainties_and_limits_use_them(sgp, certain, tmp_path):
    words = ("roughness", certain, "--l-mm", "0")
    answer = sgp(*words, "--scale-percent", "1", "--json").figures()
    height = {one["name"]: one for one in answer["regions"][0]["parameters"]}["Sq"]
    sgp(*words, "--scale-percent", "1", "--out", tmp_path / "table").ok()
    with (tmp_path / "table" / "parameters.csv").open() as file:
        row = next(one for one in csv.DictReader(file) if one["parameter"] == "Sq")
    assert row["nominal_form"] == "plane"
    budget = {name: float(row[name.replace(" ", "_")]) for name in height["budget"]}
    assert budget == pytest.approx(height["budget"], rel=1e-5)
    assert height["budget"]["scale"] == pytest.approx(0.01 * height["value"], rel=0.2)
    assert 0 < height["sigma"] < 0.2 * height["value"]
    limits = tmp_path / "limits.toml"
    for share, code, word in ((2, 0, "conforms"), (1, 0, "undecided"), (0.3, 6, "exceeded")):
        limits.write_text(f'[[limit]]\nparameter = "Sq"\nmost = {share * height["value"]}\n')
        out = tmp_path / word
        answer = sgp(*words, "--limits", limits, "--out", out)
        assert (answer.code, word in answer.out) == (code, True)
        assert (
            json.loads((out / "roughness.json").read_text())["metrics"]["limits"][0]["answer"]
            == word
        )


@pytest.mark.parametrize(
    ("verdict", "word"), [("good", "conforms"), ("check", "undecided"), ("do-not-use", "undecided")]
)
def test_limits_prove_nothing_if_the_verdict_is_not_good(sgp, certain, tmp_path, verdict, word):
    file = certain / "normals" / "normals.json"
    record = json.loads(file.read_text())
    record["verdict"] = verdict
    record.pop("record_sha256", None)
    file.write_text(json.dumps(record))
    limits = tmp_path / "limits.toml"
    limits.write_bytes(b'\xef\xbb\xbf[[limit]]\r\nparameter = "Sq"\r\nmost = 1e6\r\n')
    answer = sgp("roughness", certain, "--limits", limits, "--json").figures()
    assert [one["answer"] for one in answer["limits"]] == [word]


def test_the_step_of_a_wall_has_the_uncertainty_of_known_heights(sgp, tmp_path):
    """Normals show a third of the wall, and few known heights do not move the surface."""
    slopes = np.zeros((60, 160))
    slopes[:, 79:81] = 0.05 / PIXEL
    vectors = np.dstack([-slopes, 0 * slopes, np.ones_like(slopes)])
    vectors += np.random.default_rng(0).normal(0, 0.004, vectors.shape)
    field = Field(NormalMap.from_vectors(vectors), None, np.full(slopes.shape, 0.3, np.float32))
    write_field(tmp_path / "normals", field)
    prior = tmp_path / "prior.csv"
    points = [f"{x},{y},{0.2 * (x > 80)}\n" for x in (20, 60, 100, 140) for y in (10, 50)]
    prior.write_text("".join(["x_px,y_px,height_mm\n", *points]))
    words = ("surface", tmp_path / "normals", "--pixel-mm", PIXEL, "--smooth", "--prior", prior)
    sgp(*words, "--prior-sigma", "0.001", "--out", tmp_path / "surface").ok()
    answer = sgp("roughness", tmp_path, "--step", "10,30,150,30", "--json").figures()
    depth = parameters(answer)["d"]
    assert depth["value"] < 150
    assert abs(depth["value"] - 200) < 2 * depth["sigma"] < 300
    assert depth["budget"]["known heights"] > 50


def test_pixels_are_those_at_the_height_of_a_place(sgp, tmp_path):
    """Waves of 6 mm on two levels: a camera sees the upper one nearer and larger."""
    size, distance, wave = (60, 240), 600.0, 2 * np.pi / 6
    camera = CameraModel([[1200, 0, 119.5], [0, 1200, 29.5], [0, 0, 1]], *size[::-1], distance)
    write_camera(tmp_path / "camera.json", camera)
    column, z = np.arange(240) - 119.5, np.zeros(240)
    for _ in range(100):
        x = column * (distance - z) / 1200
        z = 14 * np.tanh(x / 14) + 0.2 * np.sin(wave * x)
    slopes = np.tile(np.cosh(x / 14) ** -2 + 0.2 * wave * np.cos(wave * x), (size[0], 1))
    vectors = np.dstack([-slopes, 0 * slopes, np.ones_like(slopes)])
    write_normals(tmp_path / "normals", NormalMap.from_vectors(vectors))
    words = ("surface", tmp_path / "normals", "--camera", tmp_path / "camera.json", "--smooth")
    sgp(*words, "--out", tmp_path / "surface").ok()
    lines = "--line", "5,30,60,30", "--line", "180,30,235,30"
    words = ("roughness", tmp_path, *lines, "--l-mm", "0", "--form", "quadric", "--json")
    answer = sgp(*words).figures()
    for number, columns in enumerate((slice(5, 61), slice(180, 236))):
        pixel = (1 - z[columns].mean() / distance) / 2
        assert answer["regions"][number]["pixel_mm"] == pytest.approx(pixel, rel=1e-3)
        width = parameters(answer, number)["RSm"]["value"]
        assert width == pytest.approx(6, rel=0.01)


def other_normals(folder):
    file = folder / "normals" / "normals.exr"
    write_exr(file, np.ascontiguousarray(read_image(file)[::-1]))


def smaller_deviations(folder):
    file = folder / "normals" / "normal_sigma_deg.exr"
    write_exr(file, read_image(file) / np.float32(10))


def moved(folder):
    folder.rename(folder.with_name("moved"))
    other_normals(folder.with_name("moved"))


def of_another_object(folder):
    (folder / "normals").rename(folder.with_name("elsewhere"))
    field = seen(relief((170, 190), 9), View(95, 85, 0.0), (120, 140), 0)[0]
    write_field(folder / "normals", field, pixel_mm=0.05)


CHANGED = {
    "normals": (other_normals, "certain", "normals: has changed since"),
    "deviations": (smaller_deviations, "certain", "normal_sigma_deg.exr: was changed"),
    "normals of a moved result": (moved, "moved", "normals: has changed since"),
    "another object": (of_another_object, "certain", "is of another object"),
}


@pytest.mark.parametrize("name", CHANGED)
def test_normals_that_were_not_integrated_are_refused(sgp, certain, name):
    change, folder, message = CHANGED[name]
    change(certain)
    assert message in sgp("roughness", certain.with_name(folder)).error_line(4)


def test_known_heights_of_one_part_do_not_join_it_with_others(sgp, tmp_path):
    mask = np.ones((60, 100), bool)
    mask[:, 60:64] = False
    normals = NormalMap.from_vectors(np.tile([0.0, 0.0, 1.0], (60, 100, 1)), mask)
    write_normals(tmp_path / "normals", normals)
    prior = tmp_path / "prior.csv"
    for right, parts in (("", True), ("80,30,1.0\n", False)):
        prior.write_text(f"x_px,y_px,height_mm\n20,20,1.0\n{right}")
        words = ("surface", tmp_path / "normals", "--pixel-mm", PIXEL, "--prior", prior)
        sgp(*words, "--out", tmp_path / "surface", "--force").ok()
        answer = sgp("roughness", tmp_path, "--json")
        assert ("roughness-parts" in answer.codes()) == parts
        assert answer.figures()["regions"][0]["pixels"] == (60 * 60 if parts else 96 * 60)


@pytest.mark.parametrize(("common_deg", "named"), [(0.0, True), (0.2, False)])
def test_lights_without_errors_are_named(sgp, certain, common_deg, named):
    file = certain / "normals" / "normals.json"
    record = json.loads(file.read_text())
    record["metrics"]["normal_sigma_common_deg"] = common_deg
    record.pop("record_sha256", None)
    file.write_text(json.dumps(record))
    assert ("roughness-lights-exact" in sgp("roughness", certain, "--json").codes()) == named
