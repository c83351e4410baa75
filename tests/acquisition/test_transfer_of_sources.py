"""The transfer curve of a source: chosen, recorded by imports, kept or removed by exports."""

from __future__ import annotations

import shutil
import tomllib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its own name for itself
import pytest
from PIL import Image

from acquisition import (
    LINEAR,
    SRGB,
    DataError,
    Lights,
    Source,
    TransferCurve,
    import_frames,
    read_source,
    verify_session,
    watch_folder,
    write_exr,
    write_png,
)
from acquisition.exports import prepare_export
from acquisition.imports import Watch, lights_in_order, read_import
from acquisition.pixels import write_tiff
from acquisition.session.manifest import FORMAT_VERSION, parse_manifest
from acquisition.source import Linearizer

TABLE = TransferCurve.table([[0, 0], [100, 10], [255, 100]])
GREY = np.arange(256, dtype=np.uint8).reshape(16, 16)
GOLDEN = Path(__file__).parent
LIGHTS = Lights(directions=np.array([[0, 0, 1.0], [0.5, 0, 1], [0, 0.5, 1]]))


def jpegs(folder: Path, count: int = 3) -> Path:
    folder.mkdir()
    for index in range(count):
        cv2.imwrite(str(folder / f"a.{index}.jpg"), np.full((8, 8), 60 * index + 20, np.uint8))
    return folder


def grey_pngs(folder: Path, dtype: type = np.uint8, count: int = 3) -> Path:
    folder.mkdir()
    for index in range(count):
        write_png(folder / f"a.{index}.png", np.roll(GREY, index).astype(dtype))
    return folder


def signals(source: Source) -> np.ndarray:
    linear = Linearizer(source)
    return np.stack([linear.signal(frame) for frame in source.frames])


@pytest.mark.parametrize(
    ("make", "curve", "notice"),
    [
        pytest.param(
            jpegs, SRGB,
            "the samples are read as sRGB (8-bit JPEG without colour metadata)", id="jpeg",
        ),
        pytest.param(
            grey_pngs, LINEAR,
            "the samples are read as linear (8-bit PNG without colour metadata)", id="png",
        ),
        pytest.param(lambda at: grey_pngs(at, np.uint16), LINEAR, "", id="png of 16 bits"),
    ],
)  # fmt: skip
def test_one_notice_reports_the_choice(tmp_path: Path, make, curve, notice: str) -> None:
    source = read_source(make(tmp_path / "in"))
    assert source.transfer == curve
    assert [one.text for one in source.warnings] == ([notice] if notice else [])
    assert all((one.code, one.severity) == ("transfer-curve", "info") for one in source.warnings)


@pytest.mark.parametrize("curve", [LINEAR, SRGB, TransferCurve.power(1.8), TABLE])
def test_the_caller_decides(tmp_path: Path, curve: TransferCurve) -> None:
    source = read_source(jpegs(tmp_path / "in"), transfer=curve)
    assert (source.transfer, source.transfer_origin) == (curve, "given")
    assert source.warnings == ()


def test_images_with_different_curves_are_refused(tmp_path: Path) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    for index, space in enumerate((1, 1, 2)):
        tags = Image.Exif()
        tags.get_ifd(0x8769)[0xA001] = space
        Image.fromarray(GREY).save(folder / f"a.{index}.jpg", exif=tags.tobytes())
    with pytest.raises(DataError, match=r"a\.2\.jpg: gamma 2\.19922 \(Exif.*a\.0\.jpg is sRGB"):
        read_source(folder)
    assert read_source(folder, transfer=SRGB).transfer == SRGB


def test_floats_are_linear_and_quiet(tmp_path: Path) -> None:
    for index in range(3):
        write_exr(tmp_path / f"a.{index}.exr", GREY.astype(np.float32))
    source = read_source(tmp_path)
    assert (source.transfer, source.warnings) == (LINEAR, ())


@pytest.mark.parametrize("curve", [SRGB, TransferCurve.power(2.2), TABLE])
def test_whole_numbers_are_decoded_in_double_precision(tmp_path: Path, curve) -> None:
    write_png(tmp_path / "a.0.png", GREY)
    (signal,) = signals(read_source(tmp_path, transfer=curve))
    expected = curve.light(GREY / 255).astype(np.float32)
    np.testing.assert_array_equal(signal, expected)
    assert (signal.min(), signal.max()) == (0, 1)


def test_levels_are_removed_before_the_curve(tmp_path: Path) -> None:
    write_png(tmp_path / "a.0.png", GREY)
    source = replace(read_source(tmp_path, transfer=SRGB), black_level=20.0, white_level=220.0)
    signal, saturated = Linearizer(source).signal_and_saturation(source.frames[0])
    assert (signal[GREY <= 20] == 0).all()
    np.testing.assert_allclose(signal[GREY == 120], SRGB.light(0.5), rtol=1e-6)
    np.testing.assert_array_equal(saturated, GREY >= 220)


@pytest.mark.parametrize("curve", [LINEAR, SRGB])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_bands_of_rows_give_the_signal_of_the_frame(tmp_path: Path, curve, dtype) -> None:
    rng = np.random.default_rng(2)
    images = rng.integers(0, 256, (2, 83, 7, 3)).astype(dtype)
    for index, image in enumerate(images):
        write_png(tmp_path / f"a.{index}.png", image)
    source = replace(read_source(tmp_path, transfer=curve), black_level=9.0, white_level=220.0)
    # The second image is a dark frame of the first.
    light, dark = source.frames
    source = replace(source, frames=(light, replace(dark, role="dark")))
    linear = Linearizer(source)
    signal, saturated = linear.signal_and_saturation(light)
    assert (signal < 0).any()
    bands = list(linear.bands(light))
    assert len(bands) == 3
    np.testing.assert_array_equal(np.concatenate([band for _, band, _ in bands]), signal)
    np.testing.assert_array_equal(np.concatenate([above for *_, above in bands]), saturated)
    assert [row for rows, *_ in bands for row in range(*rows.indices(83))] == list(range(83))


@pytest.mark.parametrize("curve", [LINEAR, SRGB, TransferCurve.power(1.8), TABLE])
def test_an_import_records_the_curve_and_keeps_the_samples(tmp_path: Path, curve) -> None:
    source = read_import(grey_pngs(tmp_path / "in"), transfer=curve)
    session = import_frames(source, tmp_path / "out")
    assert session.transfer == curve
    np.testing.assert_array_equal(session.frames[0].read(), GREY)
    recorded = tomllib.loads((tmp_path / "out/session.toml").read_text(encoding="utf-8"))
    assert recorded["format_version"] == FORMAT_VERSION
    assert recorded["transfer"] == curve.record()
    assert verify_session(tmp_path / "out").ok
    again = read_source(tmp_path / "out")
    assert (again.transfer, again.warnings) == (curve, ())
    np.testing.assert_array_equal(signals(again), signals(source))
    assert read_source(tmp_path / "out", transfer=LINEAR).transfer == LINEAR


def test_an_import_without_a_word_records_what_the_files_are(tmp_path: Path) -> None:
    session = import_frames(read_import(jpegs(tmp_path / "in")), tmp_path / "out")
    assert session.transfer == SRGB


@pytest.mark.parametrize("version", [1, 2, 3])
def test_sessions_without_the_key_are_linear(version: int) -> None:
    name = "golden_session" if version == 1 else f"golden_session_{version}"
    assert read_source(GOLDEN / name).transfer == LINEAR


@pytest.mark.parametrize(("version", "known"), [(1, False), (2, False), (3, True)])
def test_the_key_belongs_to_version_3(version: int, known: bool) -> None:
    name = "golden_session" if version == 1 else f"golden_session_{version}"
    path = GOLDEN / name / "session.toml"
    data = path.read_bytes() + b'\n[transfer]\nkind = "srgb"\n'
    if known:
        assert parse_manifest(data, path).transfer is not None
        return
    with pytest.raises(DataError, match=f"'transfer': format version {version} does not have it"):
        parse_manifest(data, path)


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ('kind = "pq"', "transfer.kind"),
        ('kind = "power"', "only a power has an exponent"),
        ('kind = "power"\nexponent = 50.0', "give 0.1 to 10"),
        ('kind = "srgb"\nexponent = 2.2', "only a power has an exponent"),
        ('kind = "table"\npoints = [[0.0, 0.0], [0.5, 0.9], [1.0, 0.5]]', "ends at the white"),
        ('kind = "srgb"\ngamma = 2.2', "unknown key 'transfer.gamma'"),
    ],
)
def test_invalid_curves_of_sessions_are_refused(table: str, said: str) -> None:
    path = GOLDEN / "golden_session_3" / "session.toml"
    with pytest.raises(DataError, match=said) as caught:
        parse_manifest(path.read_bytes() + f"\n[transfer]\n{table}\n".encode(), path)
    assert "\n" not in str(caught.value)


def imported(folder: Path, curve: TransferCurve) -> Path:
    source = read_import(grey_pngs(folder / "in"), lights=LIGHTS, transfer=curve)
    import_frames(source, folder / "session")
    return folder / "session"


CURVES = pytest.mark.parametrize(
    "curve", [LINEAR, SRGB, TransferCurve.power(1.8), TABLE], ids=lambda curve: curve.kind
)
LAYOUTS = pytest.mark.parametrize("layout", ["lp", "diligent", "alicevision", "exr"])


@CURVES
@LAYOUTS
def test_raw_exports_give_the_light_of_the_session(tmp_path: Path, layout, curve) -> None:
    session = imported(tmp_path, curve)
    export = prepare_export(session, layout)
    export.write(tmp_path / "out")
    again = read_source(tmp_path / "out")
    assert again.transfer == curve
    assert "transfer-curve" not in [notice.code for notice in again.warnings]
    scale = 255 if layout == "exr" and curve == LINEAR else 1
    expected = signals(read_source(session)) * scale
    np.testing.assert_allclose(signals(again), expected, rtol=1e-6)
    kept = [notice.code for notice in export.warnings]
    assert ("transfer-curve-kept" in kept) == (curve != LINEAR)
    noted = (tmp_path / "out/recording.json").read_text(encoding="utf-8")
    assert ('"transfer"' in noted) == (curve != LINEAR)


@CURVES
@LAYOUTS
def test_linear_exports_are_linear(tmp_path: Path, layout, curve) -> None:
    session = imported(tmp_path, curve)
    prepare_export(session, layout, values="linear").write(tmp_path / "out")
    again = read_source(tmp_path / "out")
    assert again.transfer == LINEAR
    np.testing.assert_allclose(signals(again), signals(read_source(session)), atol=1e-5)


@CURVES
def test_exported_pngs_state_their_curve_to_other_programs(tmp_path: Path, curve) -> None:
    """Without recording.json a reader has only the header of the PNG, which cannot hold a table."""
    prepare_export(imported(tmp_path, curve), "lp").write(tmp_path / "out")
    (tmp_path / "out/recording.json").unlink()
    found = read_source(tmp_path / "out").transfer
    expected = LINEAR if curve == TABLE else curve
    assert found == expected


def test_exported_floats_are_marked(tmp_path: Path) -> None:
    for name, curve in (("linear", LINEAR), ("srgb", SRGB)):
        (tmp_path / name).mkdir()
        prepare_export(imported(tmp_path / name, curve), "exr").write(tmp_path / name / "out")
        file = oiio.ImageInput.open(str(next((tmp_path / name / "out").glob("*.exr"))))
        assert file.spec().getattribute("sgp:transfer") == curve.name
        file.close()


def test_an_export_is_imported_with_its_curve(tmp_path: Path) -> None:
    prepare_export(imported(tmp_path, TABLE), "lp").write(tmp_path / "out")
    session = import_frames(read_import(tmp_path / "out"), tmp_path / "again")
    assert session.transfer == TABLE


def test_a_record_that_is_not_used_gives_no_curve(tmp_path: Path) -> None:
    prepare_export(imported(tmp_path, SRGB), "diligent").write(tmp_path / "out")
    other = tmp_path / "out/more.png"
    shutil.copy(tmp_path / "in/a.0.png", other)
    image = np.zeros((16, 16), np.uint16)
    write_png(other, image)
    for path in (tmp_path / "out").glob("00*.png"):
        write_png(path, image)
    names = tmp_path / "out/filenames.txt"
    names.write_text(names.read_text().replace("003.png", "more.png"))
    source = read_source(tmp_path / "out")
    assert "image-not-in-record" in [notice.code for notice in source.warnings]
    assert source.transfer == LINEAR


@pytest.mark.usefixtures("world")
def test_watched_images_record_the_curve(tmp_path: Path) -> None:
    folder = jpegs(tmp_path / "in")
    watch = Watch(folder, lights_in_order(3), gaps=False, timeout_s=0.6, settle_s=0.05)
    lines: list[str] = []
    result = watch_folder(watch, tmp_path / "out", on_message=lines.append)
    assert result.session.transfer == SRGB
    assert "a.0.jpg: the samples are read as sRGB (8-bit JPEG without colour metadata)" in lines
    given = replace(watch, transfer=TABLE)
    assert watch_folder(given, tmp_path / "given").session.transfer == TABLE


@pytest.mark.usefixtures("world")
def test_watched_images_with_another_curve_are_refused(tmp_path: Path) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    for index, space in enumerate((1, 2)):
        tags = Image.Exif()
        tags.get_ifd(0x8769)[0xA001] = space
        Image.fromarray(GREY).save(folder / f"a.{index}.jpg", exif=tags.tobytes())
    watch = Watch(folder, lights_in_order(2), gaps=False, timeout_s=0.6, settle_s=0.05)
    with pytest.raises(DataError, match=r"a\.1\.jpg: gamma 2\.19922 .* the session is sRGB"):
        watch_folder(watch, tmp_path / "out")


def test_frames_of_a_session_are_read_whatever_their_header_says(tmp_path: Path) -> None:
    """TIFF frames are ours: only session.toml states their curve."""
    write_tiff(tmp_path / "a.0.tif", GREY.astype(np.uint16))
    session = import_frames(read_import(tmp_path, transfer=SRGB), tmp_path / "out")
    assert read_source(session.folder).transfer == SRGB
