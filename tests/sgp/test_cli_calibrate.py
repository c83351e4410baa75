"""Masks of spheres: a mask given as an option, or the mask of a plain folder of images."""

import json
import shutil

import numpy as np
import pytest

from acquisition import Lights, angle_deg, read_lights, write_lights, write_png
from sgp.app import build, run
from tests.quick_sample import quick

SIZE = (150, 190)
CENTRE, RADIUS = (81.3, 70.6), 48.0


def directions(count=9):
    around = 2 * np.pi * np.arange(count) / count
    return np.stack([0.5 * np.cos(around), 0.5 * np.sin(around), np.full(count, 0.8)], axis=1)


def disc(centre=CENTRE, radius=RADIUS):
    """Return an anti-aliased mask: the coverage of each pixel is exact to about 0.01."""
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    distance = np.hypot(columns - centre[0], rows - centre[1])
    return np.rint(255 * np.clip(radius + 0.5 - distance, 0, 1)).astype(np.uint8)


def highlights():
    """Return the highlights in an orthographic view: normals half way to the view (0, 0, 1)."""
    lights = directions() / np.linalg.norm(directions(), axis=1, keepdims=True)
    half = lights + np.array([0, 0, 1])
    normals = half / np.linalg.norm(half, axis=1, keepdims=True)
    return np.asarray(CENTRE) + RADIUS * normals[:, :2] * [1, -1]


@pytest.fixture
def chrome(tmp_path):
    """A plain folder of images of a mirror ball, grey on black, under nine lights, no mask."""
    folder = tmp_path / "chrome"
    folder.mkdir()
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    for i, (x, y) in enumerate(highlights()):
        spot = np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * 1.5**2))
        image = 0.02 + 0.1 * disc() / 255.0 + 0.8 * spot
        write_png(folder / f"chrome.{i}.png", np.rint(image * 65535).astype(np.uint16))
    return folder


def error_deg(path):
    return angle_deg(read_lights(path).unit_directions, directions()).max()


@pytest.mark.parametrize("name", quick(["mask.png", "chrome.mask.png"], every=2))
def test_the_mask_file_of_a_plain_folder_marks_the_sphere(sgp, chrome, tmp_path, name):
    write_png(chrome / name, disc())
    answer = sgp("calibrate", "spheres", chrome, "--out", tmp_path / "l.json", "--json").ok()
    (sphere,) = json.loads(answer.out)["metrics"]["spheres"]
    # The anti-aliased edge is used: thresholded at 0.5 it would scatter by a third of a pixel.
    assert sphere["rms_px"] < 0.05
    assert error_deg(tmp_path / "l.json") < 0.3


def test_masks_in_the_folder_may_be_given_one_by_one(sgp, chrome, tmp_path):
    left, right = chrome / "left.mask.png", chrome / "right.mask.png"
    write_png(left, disc())
    write_png(right, disc((160, 120), 15))  # an empty place, which the answer names
    found = tmp_path / "l.json"
    answer = sgp(
        "calibrate", "spheres", chrome, "--mask", left, "--mask", right, "--out", found
    ).ok()
    assert "not used" not in answer.err
    assert "no highlight under any light on the sphere at (160, 120) px" in answer.err
    assert error_deg(found) < 0.3
    assert sgp("calibrate", "spheres", chrome, "--out", tmp_path / "m.json").code == 4


def test_an_object_in_the_mask_file_of_a_plain_folder_is_named(sgp, chrome, tmp_path):
    write_png(chrome / "mask.png", disc((150, 120), 20))
    answer = sgp("calibrate", "spheres", chrome, "--out", tmp_path / "l.json")
    assert f"{chrome / 'mask.png'} was used as the mask of a sphere" in answer.error_line(5)


def test_a_given_outline_comes_before_the_mask_file(sgp, chrome, tmp_path):
    write_png(chrome / "mask.png", disc((150, 120), 20))
    words = ("calibrate", "spheres", chrome, "--sphere", "82,70,47", "--out", tmp_path / "l.json")
    sgp(*words).ok()
    assert error_deg(tmp_path / "l.json") < 1


def as_diligent(sgp, chrome):
    names = sorted(path.name for path in chrome.glob("*.png"))
    (chrome / "filenames.txt").write_text("\n".join(names) + "\n", encoding="utf-8")
    write_png(chrome / "mask.png", disc((150, 120), 20))
    return chrome, chrome / "mask.png"


def as_lp(sgp, chrome):
    names = tuple(sorted(path.stem for path in chrome.glob("*.png")))
    write_lights(chrome / "lights.lp", Lights(directions=directions(), ids=names))
    write_png(chrome / "mask.png", disc((150, 120), 20))
    return chrome, chrome / "mask.png"


def as_session(sgp, chrome):
    session = chrome.parent / "session"
    write_png(chrome / "mask.png", disc((150, 120), 20))
    assert sgp("capture", "import", chrome, "--out", session).code == 0
    return session, session / "derived" / "mask.png"


def as_truth(sgp, chrome):
    session, mask = as_session(sgp, chrome)
    truth = session / "derived" / "truth" / "mask.png"
    truth.parent.mkdir()
    return session, mask.rename(truth)


def as_export(sgp, chrome):
    """AliceVision's layout has no table, so that it is read as a plain folder."""
    session, _ = as_session(sgp, chrome)
    out, lights = chrome.parent / "export", chrome.parent / "true.json"
    write_lights(lights, Lights(directions=directions()))
    words = ("capture", "export", session, "--format", "alicevision", "--lights", lights)
    assert sgp(*words, "--out", out).code == 0
    (out / "lights.json").unlink()
    return out, out / "mask.png"


LAYOUTS = [
    pytest.param(made, id=made.__name__)
    for made in (as_diligent, as_lp, as_session, as_truth, as_export)
]


@pytest.mark.parametrize("made", quick(LAYOUTS, every=10))
def test_the_mask_of_an_object_is_not_used_for_a_sphere(sgp, chrome, tmp_path, made):
    source, mask = made(sgp, chrome)
    assert mask.exists()
    sgp("calibrate", "spheres", source, "--out", tmp_path / "found.json").ok()
    assert error_deg(tmp_path / "found.json") < 1
    # Given as an option, the same file is the mask of a sphere, here without any highlight.
    answer = sgp("calibrate", "spheres", source, "--mask", mask, "--out", tmp_path / "m.json")
    assert "no highlight under light" in answer.error_line(5)


@pytest.mark.parametrize("made", LAYOUTS)
def test_if_no_sphere_is_found_the_unused_mask_is_named(sgp, chrome, tmp_path, made):
    for path in chrome.glob("*.png"):
        write_png(path, np.full(SIZE, 9000, np.uint16))
    source, mask = made(sgp, chrome)
    answer = sgp("calibrate", "spheres", source, "--out", tmp_path / "found.json")
    assert f"{mask} was not used, because it shows the object" in answer.error_line(5)


@pytest.fixture(scope="module")
def coin(tmp_path_factory):
    """The coin between four chrome spheres, recorded once."""
    out = tmp_path_factory.mktemp("scene") / "cs"
    assert run(build(), ["simulate", "coin-with-spheres", "--out", str(out)]) == 0
    return out


@pytest.mark.slow
def test_spheres_next_to_an_object_give_the_positions(sgp, coin, tmp_path):
    truth = read_lights(coin / "derived" / "truth" / "lights.json")
    found = tmp_path / "l.json"
    answer = sgp("calibrate", "spheres", coin, "--radius-mm", 12, "--out", found, "--json").ok()
    assert len(json.loads(answer.out)["metrics"]["spheres"]) >= 3
    lights = read_lights(found)
    assert np.linalg.norm(lights.positions_mm - truth.positions_mm, axis=1).mean() < 4
    assert angle_deg(lights.unit_directions, truth.unit_directions).mean() < 0.4


@pytest.fixture(scope="module")
def card(tmp_path_factory):
    """The same scene in a quarter of the pixels, which is enough for its card."""
    out = tmp_path_factory.mktemp("card") / "cs"
    words = ["simulate", "coin-with-spheres", "--size", "320x256", "--out", str(out)]
    assert run(build(), words) == 0
    return out


@pytest.mark.slow
def test_intensities_come_from_the_card_and_not_from_the_object(sgp, card, tmp_path):
    truth = card / "derived" / "truth" / "lights.json"
    found = tmp_path / "i.json"
    answer = sgp("calibrate", "intensities", card, "--lights", truth, "--out", found, "--json").ok()
    strength, true = (np.asarray(read_lights(p).intensities).mean(axis=1) for p in (found, truth))
    # If the coin were used as the card: mu 0, errors of 1.2 % on average.
    assert np.abs(strength / strength.mean() / (true / true.mean()) - 1).mean() < 0.006
    assert abs(json.loads(answer.out)["metrics"]["mu"] - 1) < 0.3


def test_strengths_are_one_block_and_complete_figures(sgp, card, tmp_path):
    truth = card / "derived" / "truth" / "lights.json"
    again = shutil.copytree(card, tmp_path / "again")
    words = ("calibrate", "intensities", card, again, "--height-mm", 0, "--height-mm", 0)
    found = tmp_path / "i.json"
    answer = sgp(*words, "--lights", truth, "--out", found).ok()
    lines = answer.out.splitlines()
    assert max(map(len, lines)) <= 78
    assert "vignetting cannot be separated from the card's albedo" in answer.out
    assert "std without errors of the positions" in answer.out
    errors = read_lights(found).errors
    assert errors.intensity_std.shape == (36, 3)
    assert errors.mu_std.min() > 0
    assert errors.axis_std_deg.min() > 0
    metrics = json.loads(found.read_text("utf-8"))["provenance"]["metrics"]
    assert len(metrics["mu_own"]) == len(metrics["axis_own"]) == 36


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (("--height-mm", 1, "--height-mm", 2), 2, "given 2 times for 1 source"),
        (("--ball", "300,200,50"), 2, "needs both --ball x,y,radius and --radius-mm"),
        (("--ball", "3,2,5", "--radius-mm", 9, "--even"), 2, "do not give --ball"),
        (("--channel", "rgb"), 4, "the image has one channel: use gray"),
        (("--height-mm", 900), 4, "not in front of the camera"),
    ],
)
def test_wrong_cards_are_named(sgp, card, tmp_path, options, code, message):
    truth = card / "derived" / "truth" / "lights.json"
    words = ("calibrate", "intensities", card, "--lights", truth, "--out", tmp_path / "i.json")
    assert message in sgp(*words, *options).error_line(code)


@pytest.mark.slow
def test_a_mask_of_the_card_is_used(sgp, card, tmp_path):
    truth = card / "derived" / "truth" / "lights.json"
    write_png(tmp_path / "card.png", np.full((256, 320), 255, np.uint8))
    metrics = []
    for name, mask in (("a", ()), ("b", ("--mask", tmp_path / "card.png"))):
        out = tmp_path / f"{name}.json"
        words = ("calibrate", "intensities", card, "--lights", truth, *mask, "--out", out)
        metrics.append(json.loads(sgp(*words, "--json").out)["metrics"])
    assert metrics[0] == metrics[1]
    part = np.zeros((256, 320), np.uint8)
    part[:30] = 255
    write_png(tmp_path / "part.png", part)
    words = ("calibrate", "intensities", card, "--lights", truth, "--mask", tmp_path / "part.png")
    answer = sgp(*words, "--out", tmp_path / "p.json", "--json")
    assert json.loads(answer.out)["metrics"]["pixels"] < metrics[0]["pixels"]
