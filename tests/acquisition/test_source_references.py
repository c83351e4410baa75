"""Dark and ambient frames, and samples in the high bits, in plain folders of images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from acquisition import SRGB, import_frames, read_source, watch_folder, write_png
from acquisition.imports import Watch, lights_in_order, read_import
from acquisition.pixels import write_tiff
from acquisition.source.series_facts import split_references
from calibration import linear_stack

SHAPE = (12, 16)


def image(number: int, step: int = 1) -> np.ndarray:
    values = np.random.default_rng(number).integers(2000 // step, 65536 // step, SHAPE)
    return (values * step).astype(np.uint16)


def names(*stems: str) -> list[Path]:
    return [Path(f"{stem}.png") for stem in stems]


@pytest.mark.parametrize(
    ("stems", "expected"),
    [
        (("a_1", "a_2", "a_3", "dark"), {"dark": "dark"}),
        (("1", "2", "3", "Dark_01", "AMBIENT2"), {"Dark_01": "dark", "AMBIENT2": "ambient"}),
        (("raw_1", "raw_2", "raw_3", "raw_ambient"), {"raw_ambient": "ambient"}),
        (("darkwood_1", "darkwood_2", "darkwood_3", "mask"), {}),
        (("1", "2", "3", "undark", "a_darkly_b"), {}),
    ],
)
def test_names_of_dark_and_ambient_frames(stems: tuple[str, ...], expected: dict[str, str]) -> None:
    images, found = split_references(names(*stems))
    assert {path.stem: role for path, role in found.items()} == expected
    assert len(images) == len(stems) - len(found)


@pytest.mark.parametrize("lp", [False, True])
def test_dark_and_ambient_frames_of_a_folder_are_subtracted(tmp_path: Path, lp: bool) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    for number in range(3):
        write_png(folder / f"o_{number}.png", image(number))
    write_png(folder / "dark.png", np.full(SHAPE, 700, np.uint16))
    write_png(folder / "ambient_1.png", np.full(SHAPE, 900, np.uint16))
    write_png(folder / "ambient_2.png", np.full(SHAPE, 1100, np.uint16))
    if lp:
        rows = "\n".join(f"o_{i}.png 0 0.{i} 1" for i in range(3))
        (folder / "lights.lp").write_text(f"3\n{rows}\n")
    source = read_source(folder)
    assert source.light_ids == ("o_0", "o_1", "o_2")
    line = "1 dark frame and 2 ambient frames, by name"
    assert [n.code for n in source.warnings if line in n.text] == ["reference-frames-found"]
    expected = np.stack([(image(i).astype(float) - 1000) / 65535 for i in range(3)])
    np.testing.assert_allclose(linear_stack(source).values, expected, atol=1e-6)
    session = import_frames(read_import(folder), tmp_path / "out")
    assert [(frame.role, frame.led) for frame in session.frames] == [
        ("light", 0), ("light", 1), ("light", 2), ("ambient", None), ("ambient", None),
        ("dark", None),
    ]  # fmt: skip
    again = read_source(tmp_path / "out")
    np.testing.assert_allclose(linear_stack(again).values, expected, atol=1e-6)
    assert not [n for n in linear_stack(again).warnings if n.code == "dark-frames-unused"]


def test_frames_of_other_exposure_times_are_not_subtracted(tmp_path: Path) -> None:
    """The exposure times that the files state are recorded and count."""
    for name, exposure in (("o_0", 0.1), ("o_1", 0.1), ("dark", 0.5)):
        tags = Image.Exif()
        tags.get_ifd(0x8769)[0x829A] = IFDRational(exposure)
        grey = np.full(SHAPE, 50 if name == "dark" else 200, np.uint8)
        Image.fromarray(grey).save(tmp_path / f"{name}.jpg", quality=100, exif=tags.tobytes())
    import_frames(read_import(tmp_path), tmp_path / "out")
    stack = linear_stack(read_source(tmp_path / "out"))
    assert stack.values == pytest.approx(float(SRGB.light(np.array(200 / 255))), abs=1e-6)
    assert [notice.code for notice in stack.warnings] == ["dark-frames-missing"]


@pytest.mark.parametrize(
    ("step", "bits", "white"), [(16, 12, 65520), (4, 14, 65532), (64, 10, 65472)]
)
def test_samples_in_the_high_bits_are_recognised(
    tmp_path: Path, step: int, bits: int, white: float
) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    for number in range(3):
        write_tiff(folder / f"{number}.tif", image(number, step))
    source = read_source(folder)
    assert source.white_level == white
    (notice,) = [n for n in source.warnings if n.code == "samples-in-high-bits"]
    assert notice.text.startswith(f"{bits}-bit samples in the high bits of 16: the white level")
    assert import_frames(read_import(folder), tmp_path / "out").manifest.camera.white_dn == white
    assert read_source(tmp_path / "out").white_level == white


def test_other_images_keep_their_white_level(tmp_path: Path) -> None:
    cases = {
        "all": image(1),
        "low": (image(1) >> 4).astype(np.uint16),  # 12 bits in the low bits
        "flat": np.full(SHAPE, 32000, np.uint16),
        "coarse": (image(1) // 256 * 256).astype(np.uint16),
    }
    for name, pixels in cases.items():
        (tmp_path / name).mkdir()
        write_png(tmp_path / name / "a_1.png", pixels)
        assert read_source(tmp_path / name).white_level == 65535, name


@pytest.mark.usefixtures("world")
def test_a_watch_continues_with_samples_in_the_high_bits(tmp_path: Path) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    watch = Watch(folder, lights_in_order(2), timeout_s=0.3, settle_s=0.02)
    # The first image decides; a black image says nothing.
    for number, pixels in enumerate((image(1, 16), np.zeros(SHAPE, np.uint16))):
        write_tiff(folder / f"{number}.tif", pixels)
        result = watch_folder(watch, tmp_path / "out")
    assert result.session.complete
    assert result.session.manifest.camera.white_dn == 65520
