"""Transfers and properties from the command line: files, figures, and one line for bad input."""

import json

import cv2
import numpy as np
import pytest

from acquisition import angle_deg, read_image, write_png
from processing import NormalMap, read_normals, write_normals
from tests.cases import cases
from tests.processing.scenes import ball, relief

SIZE = (60, 70)


def disc(size, x, y, radius):
    rows, columns = np.mgrid[: size[0], : size[1]]
    return (((columns - x) ** 2 + (rows - y) ** 2 <= radius**2) * 255).astype(np.uint8)


@pytest.fixture
def maps(tmp_path):
    """A folder with a source of 40 x 50 pixels, a target and a mask of a part of the source."""
    write_normals(tmp_path / "source", relief(0, (40, 50), blur_px=1.5))
    write_normals(tmp_path / "target", ball(*SIZE, rim=0.9))
    write_png(tmp_path / "part.png", disc((40, 50), 25, 20, 14))
    return tmp_path


def record(folder, name="normals.json"):
    return json.loads((folder / name).read_text(encoding="utf-8"))


def test_a_transfer_writes_maps_errors_and_the_source_window(sgp, maps):
    out = maps / "out"
    answer = sgp(
        "detail", "transfer", maps / "source", maps / "target", "--out", out, "--profile"
    ).ok()
    assert "50 x 40 pixels of the source from 0,0, tiled 2 x 2 times" in answer.out
    made = record(out)
    for file in ("shape_error.exr", "detail_error.exr", "errors.png", "height_profile.png"):
        assert (out / file).is_file()
        assert file in made["outputs"].values()
    assert made["metrics"]["tiles"] == [2, 2]
    assert made["parameters"]["tile"] == "cut"
    assert made["metrics"]["seam_ratio"] < 1.5
    error = read_image(out / "shape_error.exr")
    assert np.nanmean(error) == pytest.approx(made["metrics"]["shape_mae_deg"], rel=1e-3)
    assert made["metrics"]["height_rms_px"] < made["metrics"]["height_range_px"]


def test_the_height_profile_data_agree_with_the_figures(sgp, maps):
    out = maps / "out"
    sgp("detail", "transfer", maps / "source", maps / "target", "--out", out, "--profile").ok()
    metrics = record(out)["metrics"]
    assert record(out)["outputs"]["height_profile_data"] == "height_profile.csv"
    lines = (out / "height_profile.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "pixel,target_px,result_px,smoothed_px"
    pixel, target, result, smoothed = np.loadtxt(lines[1:], delimiter=",").T
    # For a map with few pixels, all pixels are listed.
    np.testing.assert_array_equal(pixel, np.arange(read_normals(out).normal_map.mask.sum()))
    assert (np.diff(target) >= 0).all()
    for heights, name in ((result, "height_rms_px"), (smoothed, "height_smoothed_rms_px")):
        assert np.sqrt(np.mean((heights - target) ** 2)) == pytest.approx(metrics[name], rel=1e-4)
    assert np.ptp(target) == pytest.approx(metrics["height_range_px"], rel=1e-5)


def test_a_part_is_transferred_and_the_rest_stays(sgp, maps):
    out = maps / "out"
    sgp(
        *("detail", "transfer", maps / "source", maps / "target", "--out", out),
        *("--source-mask", maps / "part.png", "--at", "35,30", "--rotate-deg", "30", "--mirror"),
    ).ok()
    made = record(out)
    assert made["parameters"]["rotate_deg"] == 30
    assert made["metrics"]["seam_ratio"] > 0
    assert any(name.endswith("part.png") for name in made["inputs"])
    outside = disc(SIZE, 35, 30, 15.5) == 0
    found, given = read_normals(out).normal_map, read_normals(maps / "target").normal_map
    changed = angle_deg(found.normals, given.normals) > 0.01
    assert not changed[outside].any()
    assert changed.sum() > 0.8 * np.pi * 14**2


def test_the_scale_makes_the_part_larger(sgp, maps):
    sizes = []
    for scale in ("1", "1.5"):
        answer = sgp(
            *("detail", "transfer", maps / "source", maps / "target", "--out", maps / scale),
            *("--source-mask", maps / "part.png", "--at", "35,30", "--scale", scale, "--json"),
        ).ok()
        sizes.append(json.loads(answer.out)["metrics"]["pixels"])
    assert sizes[1] / sizes[0] == pytest.approx(1.5**2, rel=0.05)


def test_properties_of_one_map_and_with_targets(sgp, maps):
    out = maps / "one"
    sgp("detail", "properties", maps / "source", "--out", out).ok()
    metrics = record(out, "properties.json")["metrics"]
    assert set(metrics["idempotence"]) == {"2", "3", "4"}
    assert metrics["rotation_similarity"]["norm_2"] > 0
    error = read_image(out / "separability.exr")
    assert np.nanmean(error) == pytest.approx(metrics["separability_deg"], rel=1e-3)
    heights = [np.ptp(read_image(out / f"{name}.exr")) for name in ("height", "detail_height")]
    assert heights[0] > heights[1] > 0
    assert (out / "properties.png").is_file()
    assert "chain" not in metrics

    out = maps / "several"
    targets = (maps / "target", maps / "source")
    sgp("detail", "properties", maps / "source", *targets, "--out", out).ok()
    metrics = record(out, "properties.json")["metrics"]
    assert [step["target"] for step in metrics["chain"]] == [
        str(path) for path in (*targets, targets[0])
    ]
    assert len(metrics["exchange_detail_mae_deg"]) == 2
    assert (out / "exchange.png").is_file()


def not_unit(maps):
    write_png(maps / "source" / "normals.png", np.full((40, 50, 3), 150, np.uint8))
    (maps / "source" / "normals.exr").unlink()


def other_mask(maps):
    write_png(maps / "part.png", disc((30, 30), 15, 15, 9))


@cases(
    ("spoil", "words", "code", "text"),
    {
        "outside": (None, ["--at", "900,0"], 4, "does not reach the mask"),
        "half a pixel": (None, ["--at", "1.5,0"], 2, "--at must be whole pixels"),
        "infinite": (None, ["--at", "inf,0"], 2, "--at inf,0: give 2 numbers"),
        "far away": (None, ["--at", "1e300,0"], 4, "does not reach the mask"),
        "not a number": (None, ["--at", "nan,0", "--mirror"], 2, "--at nan,0: give 2 numbers"),
        "w": (None, ["--w", "30"], 4, "larger than the normal map"),
        "no position": (None, ["--scale", "1.1"], 4, "has no position on a target"),
        "no scale": (None, ["--scale", "0"], 2, "--scale"),
        "tiny scale": (None, ["--scale", "1e-9", "--at", "9,9"], 4, "a scale of 1e-09"),
        "refined part": (None, ["--mirror", "--refine", "1"], 2, "--refine"),
        "masks do not overlap": (None, ["--mirror", "--at", "-90,0"], 4, "does not overlap"),
        "mask size": (other_mask, ["--source-mask", "part.png", "--at", "9,9"], 4, "part.png"),
        "no mask": (None, ["--source-mask", "none.png"], 2, "none.png"),
        "not unit": (not_unit, [], 4, "is not a normal map"),
    },
)
def test_bad_transfers_get_one_line(sgp, maps, monkeypatch, spoil, words, code, text):
    monkeypatch.chdir(maps)
    if spoil is not None:
        spoil(maps)
    words = ("detail", "transfer", "source", "target", "--out", "out", *words)
    assert text in sgp(*words).error_line(code)
    assert not (maps / "out").exists()


def test_maps_of_different_size_do_not_combine(sgp, maps):
    assert "must have the same size" in sgp(
        "detail", "combine", maps / "target", maps / "source", "--out", maps / "out"
    ).error_line(4)


@pytest.mark.parametrize("erased", ["black", "alpha"])
def test_pixels_that_an_edited_detail_lost_are_reported(sgp, maps, erased):
    """A patch was painted over in an image program, and the picture has no mask file."""
    sgp("detail", "separate", maps / "target", "--out", maps / "parts")
    pixels = cv2.imread(str(maps / "parts" / "detail.png"), cv2.IMREAD_UNCHANGED)
    pixels[20:30, 30:40, 3 if erased == "alpha" else slice(3)] = 0
    cv2.imwrite(str(maps / "edited.png"), pixels)
    report = sgp(
        *("detail", "combine", maps / "parts" / "shape.exr", maps / "edited.png"),
        *("--out", maps / "back", "--json"),
    ).report()
    assert report["metrics"]["pixels"] == ball(*SIZE, rim=0.9).mask.sum() - 100
    lost = "edited.png: 100 pixels of the shape have no detail and are masked out"
    assert [line for line in report["warnings"] if line.endswith(lost)]


def test_a_map_with_an_alpha_channel_is_read_without_it(sgp, maps):
    pixels = cv2.imread(str(maps / "source" / "normals.png"), cv2.IMREAD_UNCHANGED)
    pixels[..., 3] = 65535
    assert cv2.imwrite(str(maps / "alpha.png"), pixels)
    found = read_normals(maps / "alpha.png").normal_map
    given = read_normals(maps / "source").normal_map
    assert angle_deg(found.normals, given.normals).max() < 0.01
    sgp("detail", "transfer", maps / "alpha.png", maps / "target", "--out", maps / "out").ok()


@pytest.mark.parametrize("command", ["separate", "transfer", "properties", "combine", "compare"])
def test_alpha_is_reported_by_every_command_that_reads_maps(sgp, maps, command):
    colours = np.rint((relief(2, (40, 50)).normals / 2 + 0.5) * 255).astype(np.uint8)
    alpha = disc((40, 50), 25, 20, 17)[..., None]
    cv2.imwrite(str(maps / "cut.png"), np.concatenate([colours[..., ::-1], alpha], axis=2))
    words = {
        "separate": ["detail", "separate", "cut.png"],
        "transfer": ["detail", "transfer", "cut.png", "target"],
        "properties": ["detail", "properties", "source", "cut.png"],
        "combine": ["detail", "combine", "source", "cut.png"],
        "compare": ["compare", "cut.png", "source"],
    }[command]
    paths = [maps / word if (maps / word).exists() else word for word in words]
    answer = sgp(*paths, "--out", maps / "out", "--json").ok()
    notes = [line for line in json.loads(answer.out)["warnings"] if "alpha channel" in line]
    (note,) = notes
    assert f"is the mask, {np.count_nonzero(alpha)} of 2000 pixels" in note


@pytest.mark.parametrize("where", ["target", "target/below"])
def test_results_never_go_into_one_of_several_targets(sgp, maps, where):
    before = sorted(path.name for path in (maps / "target").iterdir())
    assert "is in the folder of the input" in sgp(
        *("detail", "properties", maps / "source", maps / "target"),
        *("--out", maps / where, "--force"),
    ).error_line(2)
    assert sorted(path.name for path in (maps / "target").iterdir()) == before


@pytest.mark.parametrize("words", [["separate"], ["transfer"], ["properties"]])
def test_help_names_the_filters(sgp, words):
    text = " ".join(sgp("detail", *words, "--help").out.replace("\u2502", " ").split())
    assert "gaussian, box, guided or bilateral. The last two do not smooth across steps" in text


def test_maps_that_do_not_overlap_are_not_compared(sgp, maps):
    whole = relief(3, (40, 50))
    for name, part in (("left", np.s_[:, :20]), ("right", np.s_[:, 30:])):
        mask = np.zeros(whole.size, np.bool_)
        mask[part] = True
        (maps / name).mkdir()
        write_normals(maps / name, NormalMap(np.where(mask[..., None], whole.normals, 0), mask))
    assert "their masks do not overlap: there is nothing to compare" in sgp(
        "compare", maps / "left", maps / "right"
    ).error_line(4)
