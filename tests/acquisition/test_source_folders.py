"""Plain folders, .lp folders and single files as sources: frames, masks and lights."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from acquisition import (
    CameraModel,
    DataError,
    Lights,
    MissingPathError,
    read_lights,
    read_source,
    write_exr,
    write_png,
)
from acquisition.pixels import write_tiff
from acquisition.source.image_folder import numbered_series
from acquisition.values import Calibrated
from tests.cases import cases
from tests.real_data import DATA, needs_data


def image(value: int, size: tuple[int, int] = (4, 6)) -> np.ndarray:
    return np.full((*size, 3), value, np.uint16)


def fill(folder: Path, *names: str) -> Path:
    """Write one image per name, whose pixel values are its index in the order of writing."""
    folder.mkdir(exist_ok=True)
    for value, name in enumerate(names):
        write_png(folder / name, image(value))
    return folder


def cone(count: int, ids: tuple[str, ...] = ()) -> Lights:
    """Return lights whose x component encodes their index."""
    directions = np.stack([np.arange(count), np.zeros(count), np.full(count, 10.0)], axis=1)
    return Lights(directions=directions, ids=ids)


def indices(lights: Lights | None) -> list[int]:
    assert lights is not None
    directions = lights.unit_directions
    return np.rint(10 * directions[:, 0] / directions[:, 2]).astype(int).tolist()


def test_natural_order_mask_and_ignored(tmp_path: Path) -> None:
    folder = fill(tmp_path, *[f"chrome.{i}.png" for i in (10, 2, 0, 1, 11)], "chrome.albedo.png")
    (folder / "notes.txt").write_text("hello")
    (folder / ".hidden").write_text("")
    (folder / "results").mkdir()
    mask = np.zeros((4, 6), np.uint8)
    mask[1:3, 2] = [127, 128]
    write_png(folder / "chrome.mask.png", mask)
    source = read_source(folder)
    assert source.kind == "images"
    assert source.light_ids == ("chrome.0", "chrome.1", "chrome.2", "chrome.10", "chrome.11")
    assert [int(frame.read()[0, 0, 0]) for frame in source.frames] == [2, 3, 1, 0, 4]
    assert source.ignored == ("chrome.albedo.png", "notes.txt", "results")
    assert source.mask is not None
    assert np.argwhere(source.mask).tolist() == [[2, 2]]
    names = [f"chrome.{i}.png" for i in (0, 1, 2, 10, 11)]
    assert source.files == tuple(folder / name for name in [*names, "chrome.mask.png"])
    assert source.size == (4, 6)
    assert (source.black_level, source.white_level, source.cfa) == (0, 65535, None)
    assert source.lights is None
    assert source.warnings == ()


@cases(
    ("names", "expected"),
    {
        "by number": (["a.2.png", "a.10.png"], ["a.2.png", "a.10.png"]),
        "leading zeros": (["a08.png", "a7.png"], ["a7.png", "a08.png"]),
        "numbers alone": (["2.png", "1.png"], ["1.png", "2.png"]),
        "the number that varies": (
            ["L00_E0.png", "L02_E0.png", "L01_E0.png", "D_E0.png"],
            ["L00_E0.png", "L01_E0.png", "L02_E0.png"],
        ),
        "a fixed number too": (["x2_1.png", "x2_2.png"], ["x2_1.png", "x2_2.png"]),
        "most numerous stem": (["a.1.png", "a.2.png", "b.1.png"], ["a.1.png", "a.2.png"]),
        "most numerous suffix": (["a.1.png", "a.2.tif", "a.3.png"], ["a.1.png", "a.3.png"]),
        "two numbers that vary": (
            ["L2_t60.png", "L10_t30.png", "L9_t60.png"],
            ["L2_t60.png", "L9_t60.png", "L10_t30.png"],
        ),
        "any case": (["A.1.PNG", "a.2.png"], ["A.1.PNG", "a.2.png"]),
        "no number": (["cat.png"], []),
        "no image": (["cat.1.txt"], []),
    },
)
def test_series(tmp_path: Path, names: list[str], expected: list[str]) -> None:
    for name in names:
        (tmp_path / name).touch()
    assert [path.name for path in numbered_series(sorted(tmp_path.iterdir()))] == expected


@cases(
    "names",
    {
        "two stems": ["a.1.png", "a.2.png", "b.1.png", "b.2.png"],
        "brackets": [f"L{i}_E{e}.png" for i in range(3) for e in range(3)],
    },
)
def test_two_series_of_equal_length_are_refused(tmp_path: Path, names: list[str]) -> None:
    for name in names:
        (tmp_path / name).touch()
    with pytest.raises(DataError, match="a folder of its own"):
        numbered_series(sorted(tmp_path.iterdir()))


LIKE_NO_OTHER = r"a\.2\.png.*a\.0\.png"
OF_ANOTHER_SIZE = r"a\.2\.png: 7 x 4 RGB uint16, but a\.0\.png is 6 x 4"
OUTSIDE = r"mask\.png: a mask with nothing inside"


MISFITS = {
    "size": ("a.2.png", image(0, (4, 7)), OF_ANOTHER_SIZE),
    "grey among RGB": ("a.2.png", np.zeros((4, 6), np.uint16), LIKE_NO_OTHER),
    "8 bit among 16": ("a.2.png", np.zeros((4, 6, 3), np.uint8), LIKE_NO_OTHER),
    "empty mask": ("mask.png", np.full((4, 6), 0, np.uint8), OUTSIDE),
    "mask of ones": ("mask.png", np.full((4, 6), 1, np.uint8), OUTSIDE),
    "mask below half": ("mask.png", np.full((4, 6), 127, np.uint8), OUTSIDE),
    "mask of another size": (
        "mask.png",
        np.full((6, 4), 255, np.uint8),
        r"mask\.png: a mask of 4 x 6 .* images have 6 x 4",
    ),
}


@pytest.mark.parametrize(("name", "pixels", "said"), MISFITS.values(), ids=MISFITS)
def test_images_and_masks_that_do_not_fit(
    tmp_path: Path, name: str, pixels: np.ndarray, said: str
) -> None:
    folder = fill(tmp_path, "a.0.png", "a.1.png")
    write_png(folder / name, pixels)
    with pytest.raises(DataError, match=said):
        read_source(folder)


def test_a_frame_that_changes_later_is_named(tmp_path: Path) -> None:
    folder = fill(tmp_path, "a.0.png", "a.1.png")
    first, second = read_source(folder).frames
    write_png(folder / "a.0.png", image(0, (5, 5)))
    (folder / "a.1.png").unlink()
    with pytest.raises(DataError, match=r"a\.0\.png: shape \(5, 5, 3\)"):
        first.read()
    with pytest.raises(DataError, match=r"a\.1\.png: the file is missing: restore it"):
        second.read()


@pytest.mark.parametrize(
    ("write", "suffix", "pixels", "white"),
    [
        (write_png, "png", np.zeros((4, 6), np.uint8), 255),
        (write_tiff, "tif", np.zeros((4, 6), np.uint16), 65535),
        (write_exr, "exr", np.zeros((4, 6), np.float32), np.inf),
    ],
)
def test_white_level_by_type(
    tmp_path: Path, write: object, suffix: str, pixels: np.ndarray, white: float
) -> None:
    write(tmp_path / f"a.0.{suffix}", pixels)  # type: ignore[operator]
    assert read_source(tmp_path).white_level == white


def test_lights_are_matched_by_name_in_any_order(tmp_path: Path) -> None:
    folder = fill(tmp_path, *[f"a.{i}.png" for i in range(12)])
    # As a file browser sorts them: 0, 1, 10, 11, 2 ...
    names = sorted(f"a.{i}.png" for i in range(12))
    source = read_source(folder, lights=cone(12, tuple(names)))
    assert source.lights is not None
    assert source.lights.ids == tuple(f"a.{i}" for i in range(12))
    assert [names[index] for index in indices(source.lights)] == [f"a.{i}.png" for i in range(12)]
    assert source.warnings == ()


def test_lights_by_order_with_a_warning(tmp_path: Path) -> None:
    source = read_source(fill(tmp_path, "a.2.png", "a.10.png"), lights=cone(2))
    assert indices(source.lights) == [0, 1]
    assert source.lights is not None
    assert source.lights.ids == ("a.2", "a.10")
    (warning,) = source.warnings
    assert warning.code == "lights-matched-by-order"
    assert "L00" in str(warning)


def test_names_with_words_after_dots_find_their_lights(tmp_path: Path) -> None:
    names = ("scan.left", "scan.up", "IMG_0.v1")
    folder = fill(tmp_path, *[f"{name}.png" for name in names])
    rows = "".join(f"{name}.png {i} 0 10\n" for i, name in reversed([*enumerate(names)]))
    (folder / "dome.lp").write_text(f"3\n{rows}")
    source = read_source(folder)
    assert source.light_ids == ("IMG_0.v1", "scan.up", "scan.left")
    assert indices(source.lights) == [2, 1, 0]
    again = read_source(folder, lights=cone(3, ("scan.up", "scan.left", "img_0.v1")))
    assert indices(again.lights) == [2, 0, 1]
    assert again.warnings == ()


@cases(
    ("known", "unlit"),
    {
        "one was left out": (("a.0", "a.2", "a.3"), ["a.1"]),
        "half of them": (("a.3", "a.0"), ["a.1", "a.2"]),
        "most of them": (("a.3",), None),
        "another light": (("a.0", "a.2", "b.3"), None),
        "a light twice": (("a.0", "a.2", "A.2.png"), None),
    },
)
def test_images_of_lights_that_a_calibration_left_out_are_not_used(
    tmp_path: Path, known: tuple[str, ...], unlit: list[str] | None
) -> None:
    folder = fill(tmp_path, *[f"a.{i}.png" for i in range(4)])
    lights = cone(len(known), known)
    with pytest.raises(DataError, match=f"4 images for {len(known)} light"):
        read_source(folder, lights=lights)  # not calibrated, so perhaps in another order
    lights = replace(lights, calibrated=Calibrated(datetime.now(UTC)))
    if unlit is None:
        with pytest.raises(DataError, match=f"4 images for {len(known)} light"):
            read_source(folder, lights=lights)
        return
    source = read_source(folder, lights=lights)
    assert source.lights is not None
    assert source.light_ids == source.lights.ids == tuple(sorted(known))
    assert [known[i] for i in indices(source.lights)] == sorted(known)
    (warning,) = source.warnings
    assert warning.code == "images-without-light"
    assert all(name in warning.text for name in unlit)


@cases(
    ("known", "without", "expected"),
    {
        "by name": (range(6), ["1", "4"], [0, 2, 3, 5]),
        "a light that is missing": ([0, 2, 3, 4, 5], ["a.1"], [0, 1, 2, 3, 4]),
        "by name, another order": ([5, 0, 2, 3], ["1", "4"], [1, 2, 3, 0]),
        "by order, all images": (6, ["1", "4"], [0, 2, 3, 5]),
        "by order, the others": (4, ["1", "4"], [0, 1, 2, 3]),
        "other lights": (5, ["1", "4"], None),
    },
)
def test_images_that_are_left_out_need_no_light(
    tmp_path: Path, known: Iterable[int] | int, without: list[str], expected: list[int] | None
) -> None:
    folder = fill(tmp_path, *[f"a.{i}.png" for i in range(6)])
    lights = cone(known) if isinstance(known, int) else cone(len(list(known)), names(known))
    if expected is None:
        with pytest.raises(DataError, match="4 images for 5 lights"):
            read_source(folder, lights=lights, without=without)
        return
    source = read_source(folder, lights=lights, without=without)
    assert source.light_ids == tuple(f"a.{i}" for i in range(6) if str(i) not in "".join(without))
    assert indices(source.lights) == expected
    by_order = "lights-matched-by-order" in [notice.code for notice in source.warnings]
    assert by_order == isinstance(known, int)


def names(known: Iterable[int]) -> tuple[str, ...]:
    return tuple(f"a.{i}" for i in known)


def test_an_image_that_is_left_out_next_to_one_without_a_light(tmp_path: Path) -> None:
    """A calibration left out the light of image 1; the caller leaves out 1 and 3, or only 3."""
    folder = fill(tmp_path, *[f"a.{i}.png" for i in range(6)])
    lights = replace(cone(5, names([0, 2, 3, 4, 5])), calibrated=Calibrated(datetime.now(UTC)))
    for without, codes in ((["1", "3"], []), (["3"], ["images-without-light"])):
        source = read_source(folder, lights=lights, without=without)
        assert source.light_ids == names([0, 2, 4, 5])
        assert indices(source.lights) == [0, 1, 3, 4]
        assert [warning.code for warning in source.warnings] == codes
    assert read_source(folder, without=["3"]).light_ids == names([0, 1, 2, 4, 5])
    with pytest.raises(DataError, match="no image is named"):
        read_source(folder, without=["7"])


def test_lights_without_an_image_are_listed(tmp_path: Path) -> None:
    folder = fill(tmp_path, *[f"a.{i}.png" for i in (0, 1, 3, 5)])
    (notice,) = read_source(folder, lights=cone(6, names(range(6)))).warnings
    assert notice.code == "lights-without-image"
    assert "a.2, a.4" in notice.text


def test_different_numbers_of_lights_and_images_are_refused(tmp_path: Path) -> None:
    folder = fill(tmp_path, *[f"a.{i}.png" for i in range(35)])
    with pytest.raises(DataError, match="35 images for 36 lights") as caught:
        read_source(folder, lights=cone(36))
    assert str(folder) in str(caught.value)


def test_a_mask_from_the_caller_takes_precedence(tmp_path: Path) -> None:
    folder = fill(tmp_path / "images", "a.0.png")
    write_png(folder / "mask.png", np.zeros((4, 6), np.uint8))
    write_png(folder / "other.mask.png", np.zeros((4, 6), np.uint8))
    given = np.zeros((4, 6, 3), np.uint16)
    given[0, 0, 2] = 40000
    write_png(tmp_path / "given.png", given)
    source = read_source(folder, mask_path=tmp_path / "given.png")
    assert source.mask is not None
    assert np.argwhere(source.mask).tolist() == [[0, 0]]
    assert source.files == (folder / "a.0.png", tmp_path / "given.png")
    assert source.ignored == ("mask.png", "other.mask.png")
    with pytest.raises(DataError, match=r"mask\.png and other\.mask\.png are both masks"):
        read_source(folder)
    with pytest.raises(MissingPathError, match=r"none\.png"):
        read_source(folder, mask_path=tmp_path / "none.png")


def test_camera_of_another_size(tmp_path: Path) -> None:
    folder = fill(tmp_path, "a.0.png")
    camera = CameraModel(np.array([[9.0, 0, 3], [0, 9, 2], [0, 0, 1]]), 6, 4)
    assert read_source(folder, camera=camera).camera is camera
    wrong = CameraModel(camera.K, 4, 6)
    with pytest.raises(DataError, match="images of 6 x 4 pixels, but a camera of 4 x 6"):
        read_source(folder, camera=wrong)


def test_nothing_to_read(tmp_path: Path) -> None:
    with pytest.raises(MissingPathError, match="none"):
        read_source(tmp_path / "none")
    with pytest.raises(DataError, match="the folder is empty"):
        read_source(tmp_path)
    (tmp_path / "a.txt").write_text("hello")
    with pytest.raises(DataError, match=r"a\.txt"):
        read_source(tmp_path / "a.txt")
    (tmp_path / "a.0.png").write_bytes(b"not an image")
    with pytest.raises(DataError, match=r"a\.0\.png"):
        read_source(tmp_path)


def test_one_image_file(tmp_path: Path) -> None:
    fill(tmp_path, "owl.png")
    source = read_source(tmp_path / "owl.png")
    assert source.light_ids == ("owl",)
    assert source.frames[0].read().shape == (4, 6, 3)


def lp_folder(tmp_path: Path, rows: list[str]) -> Path:
    folder = fill(tmp_path / "rti", "img 1.png", "img 2.png", "img 10.png")
    text = f"{len(rows)}\r\n" + "".join(f"{row} {i} 0 10\r\n" for i, row in enumerate(rows))
    (folder / "dome.lp").write_bytes(text.encode())
    return folder


@pytest.mark.parametrize("named", ["folder", "file"])
def test_an_lp_chooses_the_images_by_name(tmp_path: Path, named: str) -> None:
    folder = lp_folder(tmp_path, ["C:\\x y\\IMG 10.PNG", "C:\\x y\\img 1.png"])
    source = read_source(folder if named == "folder" else folder / "dome.lp")
    assert source.kind == "lp"
    assert [frame.path.name for frame in source.frames] == ["img 10.png", "img 1.png"]
    assert indices(source.lights) == [0, 1]
    assert source.files == tuple(folder / name for name in ("img 10.png", "img 1.png", "dome.lp"))
    assert source.ignored == ("img 2.png",)
    assert source.warnings == ()


def test_an_lp_of_another_suffix(tmp_path: Path) -> None:
    source = read_source(lp_folder(tmp_path, ["img 2.jpg", "img 1.jpg", "img 10.jpg"]))
    assert [frame.light_id for frame in source.frames] == ["img 2", "img 1", "img 10"]
    assert indices(source.lights) == [0, 1, 2]


def test_an_lp_without_matching_names_is_matched_by_order(tmp_path: Path) -> None:
    source = read_source(lp_folder(tmp_path, ["a.jpg", "b.jpg", "c.jpg"]))
    assert [frame.light_id for frame in source.frames] == ["img 1", "img 2", "img 10"]
    assert indices(source.lights) == [0, 1, 2]
    assert "by order" in str(source.warnings[0])


@cases(
    ("rows", "match"),
    {
        "in part": (["img 1.png", "x.png"], r"only 1 of them is there, x\.png is not"),
        "no name, other count": (["a.png", "b.png"], "3 images for 2 lights"),
        "one image twice": (["img 1.png", "img 1.jpg"], "1 of them is there"),
    },
)
def test_an_lp_that_does_not_match_is_refused(tmp_path: Path, rows: list[str], match: str) -> None:
    with pytest.raises(DataError, match=match):
        read_source(lp_folder(tmp_path, rows))


def test_several_lp_files_are_refused(tmp_path: Path) -> None:
    folder = lp_folder(tmp_path, ["img 1.png"])
    (folder / "other.lp").write_text("1\nimg 1.png 0 0 1\n")
    with pytest.raises(DataError, match=r"dome\.lp and other\.lp"):
        read_source(folder)
    assert len(read_source(folder / "other.lp").frames) == 1


def test_lights_from_the_caller_override_an_lp(tmp_path: Path) -> None:
    folder = lp_folder(tmp_path, ["img 1.png", "img 2.png"])
    source = read_source(folder, lights=cone(3, ("img 3.tif", "img 2.tif", "img 1.tif")))
    assert indices(source.lights) == [2, 1]


@needs_data
@pytest.mark.parametrize("name", ["chrome", "gray", "buddha", "cat"])
def test_real_captures(name: str) -> None:
    folder = DATA / "uw" / name
    lights = read_lights(folder.parent / "lights_shipped_unreliable.txt")
    source = read_source(folder, lights=lights)
    assert source.light_ids == tuple(f"{name}.{i}" for i in range(12))
    assert source.ignored == (("buddha.albedo.tga",) if name == "buddha" else ())
    assert source.mask is not None
    assert 0.1 < source.mask.mean() < 0.3
    assert "by order" in str(source.warnings[1])
    # Inside the mask the object is bright (on a mirror only a spot), the background is dark.
    brightest = np.max([frame.read().max(axis=2) for frame in source.frames], axis=0)
    assert np.percentile(brightest[source.mask], 99.5) > 100
    assert np.median(brightest[~source.mask]) < 10


@needs_data
def test_a_real_raw_file() -> None:
    source = read_source(DATA / "raw" / "RAW_KODAK_DC50.KDC")
    assert (source.cfa, source.white_level, source.size) == ("GRBG", 16383, (512, 768))
    assert source.frames[0].read().dtype == np.uint16


def test_a_folder_without_a_series_says_why(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="the folder is empty"):
        read_source(tmp_path)
    (tmp_path / "photos").mkdir()
    with pytest.raises(DataError, match="no numbered images"):
        read_source(tmp_path)
    write_png(tmp_path / "photos" / "im0.png", np.zeros((4, 5), np.uint8))
    with pytest.raises(DataError, match="no images here, but there are some in photos"):
        read_source(tmp_path)
    for i in range(3):
        (tmp_path / f"IMG_{i}.HEIC").write_bytes(b"ftypheic")
    with pytest.raises(
        DataError, match=r"3 HEIF images \(IMG_0.HEIC\), which cannot be read: save"
    ):
        read_source(tmp_path)
