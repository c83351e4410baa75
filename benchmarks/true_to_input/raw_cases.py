"""Camera RAW files with every kind of level and mosaic, and samples clipped below white."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from true_to_input.case import Case, Outcome, Run, judge, later
from true_to_input.dng_writer import area, black, delta, white, write_dng
from true_to_input.relief import INSIDE, MASK, H, W, directions, error_of, images, write_lp

from acquisition import Lights, import_frames, read_source, write_lights
from acquisition.imports import read_import
from acquisition.pixels import read_raw
from rig.arrays import AnyArray

_LIGHT = {"R": 800.0, "G": 1600.0, "B": 400.0}
_GAIN = {"R": 0.6, "G": 1.0, "B": 0.5}
_XTRANS = "GGRGGBGGBGGRBRGRBGGGBGGRGGRGGBRBGBRG"
_QUAD = "RRGGRRGGGGBBGGBB"
_FOUND = ("clipped-below-white", "samples-in-low-bits")


# --- RAW files: the light above black of each sample is known ---------------------------------


def _at(table: Any, y: AnyArray, x: AnyArray) -> AnyArray:
    block = np.atleast_2d(table)
    return block[y % block.shape[0], x % block.shape[1]]


def _read_dng(
    folder: Path,
    *,
    pattern: str | None = "RGGB",
    levels: Any = 256.0,
    rows: AnyArray | None = None,
    columns: AnyArray | None = None,
    origin: tuple[int, int] = (0, 0),
    **options: Any,
) -> Outcome:
    """Write a mosaic of known light on known black levels, and compare what `read_raw` finds."""
    border = 8 if origin != (0, 0) else 0
    top, left = origin
    y, x = np.mgrid[: H + border, : W + border] - np.array(origin).reshape(2, 1, 1)
    light = np.full(y.shape, 1200.0)
    if pattern is not None:
        side = round(len(pattern) ** 0.5)
        light = _at(np.vectorize(_LIGHT.get)(np.array(list(pattern)).reshape(side, side)), y, x)
    light = light.astype(np.float64) + (7 * y + 3 * x) % 50
    dark = _at(levels, y, x).astype(np.float64)
    inside = slice(top, top + H), slice(left, left + W)
    extra = [white(4095), *black(levels)]
    if rows is not None:
        dark[inside] += rows[:, None]
        extra.append(delta(rows, rows=True))
    if columns is not None:
        dark[inside] += columns
        extra.append(delta(columns, rows=False))
    if border:
        extra.append(area(top, left, top + H, left + W))
    path = folder / "a.dng"
    data = np.clip(np.round(light + dark), 0, 4095).astype(np.uint16)
    write_dng(path, data, pattern=pattern, extra=extra, **options)
    raw = read_raw(path)
    height, width = raw.pixels.shape
    # A reader may leave out the first row and column of an area with an odd origin.
    truth = light[inside][H - height :, W - width :]
    side = round(len(raw.black_levels_dn) ** 0.5)
    found = np.array(raw.black_levels_dn).reshape(side, side)
    off = raw.pixels - _at(found, *np.mgrid[:height, :width]) - truth
    cfa = None
    if pattern is not None:
        side = round(len(pattern) ** 0.5)
        letters = np.array(list(pattern)).reshape(side, side)
        cfa = "".join(np.roll(letters, (height - H, width - W), (0, 1)).ravel())
    text = f"{raw.cfa}, off by {off.min():.1f} to {off.max():.1f} DN"
    right = raw.cfa == cfa and np.abs(off).max() <= 1 and raw.white_level_dn == 4095
    return Outcome("right" if right else "wrong", text)


@later
def _refused_dng(
    folder: Path, data: AnyArray, names: Sequence[str], *, code: int | None = None, **options: Any
) -> Outcome:
    """Write a file that cannot be read; ``code`` replaces the number of its compression."""
    path = folder / "a.dng"
    write_dng(path, data, **options)
    if code is not None:
        import tifffile

        with tifffile.TiffFile(path, mode="r+b") as file:
            file.pages[0].tags[259].overwrite(code)
    try:
        raw = read_raw(path)
    except Exception as error:  # noqa: BLE001 - the message is the outcome
        named = all(name in str(error) for name in names)
        return Outcome("refused by name" if named else "vague", str(error).split(": ", 1)[-1])
    return Outcome("wrong", f"read as {raw.cfa}, {raw.pixels.max()} DN at most")


def _plain(value: float = 1500) -> AnyArray:
    y, x = np.mgrid[:H, :W]
    return np.round(value + (7 * y + 3 * x) % 50).astype(np.uint16)


# --- Series of the relief -------------------------------------------------------------------------


def _series(
    folder: Path, frames: Sequence[Any], write: Callable[[Path, Any], None], suffix: str
) -> Path:
    """Write the images of the relief, their lights and the mask into a folder."""
    source = folder / "src"
    source.mkdir()
    names = [f"IMG_{i + 1:04d}{suffix}" for i in range(len(frames))]
    for name, frame in zip(names, frames, strict=True):
        write(source / name, frame)
    write_lp(source / "l.lp", names, directions(len(frames)))
    cv2.imwrite(str(source / "mask.png"), MASK)
    return source


def _mosaic(pattern: str | None) -> AnyArray:
    if pattern is None:
        return np.ones((H, W))
    block = np.vectorize(_GAIN.get)(np.array(list(pattern)).reshape(2, 2))
    return _at(block, *np.mgrid[:H, :W]).astype(np.float64)


def _dng_series(
    folder: Path,
    *,
    pattern: str | None = "RGGB",
    levels: Any = 256.0,
    rows: AnyArray | None = None,
    scale: float = 0.9,
    full: int = 4095,
    clip: Any = None,
    whites: Sequence[int] = (),
    **options: Any,
) -> Path:
    """Write DNG files of the relief; ``clip`` is the value at which the sensor is full."""
    dark = _at(levels, *np.mgrid[:H, :W]).astype(np.float64)
    extra = [white(*(whites or (full,))), *black(levels)]
    if rows is not None:
        dark = dark + rows[:, None]
        extra.append(delta(rows, rows=True))
    most = np.minimum(full, full if clip is None else _at(clip, *np.mgrid[:H, :W]))

    def write(path: Path, light: AnyArray) -> None:
        dn = light * _mosaic(pattern) * (full - dark.mean()) + dark
        data = np.clip(np.round(dn), 0, most).astype(np.uint16)
        write_dng(path, data, pattern=pattern, extra=extra, **options)

    return _series(folder, _unclipped(scale), write, ".dng")


def _unclipped(scale: float, *, noise: float = 0.001, count: int = 12) -> AnyArray:
    """Return images of the relief that may exceed 1."""
    most = max(scale, 1.0)
    return images(directions(count), scale=scale / most, noise=noise / most) * most


def _judged(source: Path, *options: object, limit: float = 0.3) -> Outcome:
    answer, error = error_of(source, *options)
    if answer.code:
        return Outcome("wrong", answer.message)
    return judge(answer, error, limit=limit)


def _stated(source: Path, *options: object, limit: float = 0.3) -> Outcome:
    answer, error = error_of(source, *options)
    if answer.code:
        return Outcome("wrong", answer.message)
    return judge(answer, error, limit=limit, codes=_FOUND)


def _imported(source: Path, limit: float = 0.3) -> Outcome:
    session = source.with_name("session")
    import_frames(read_import(source), session)
    return _judged(session, limit=limit)


def _dngs(judged: Callable[[Path], Outcome], **series: Any) -> Run:
    return lambda folder: judged(_dng_series(folder, **series))


def _integers(dtype: type[np.unsignedinteger[Any]], full: int, clip: Any) -> Any:
    def write(path: Path, light: AnyArray) -> None:
        data = np.clip(np.round(light * full), 0, clip).astype(dtype)
        cv2.imwrite(str(path), data[..., ::-1] if data.ndim == 3 else data)

    return write


def _floats(clip: float, dtype: Any = np.float32) -> Callable[[Path, Any], None]:
    def write(path: Path, light: AnyArray) -> None:
        import tifffile

        tifffile.imwrite(path, np.clip(light, None, clip).astype(dtype), photometric="minisblack")

    return write


def _u16(folder: Path, frames: Any, clip: Any, full: int = 65535) -> Path:
    return _series(folder, frames, _integers(np.uint16, full, clip), ".png")


def _pngs(frames: Any, clip: Any, full: int = 65535) -> Run:
    return lambda folder: _stated(_u16(folder, frames, clip, full))


def _u8(folder: Path, frames: Any, clip: Any) -> Path:
    return _series(folder, frames, _integers(np.uint8, 255, clip), ".png")


def _srgb(light: AnyArray) -> AnyArray:
    light = np.clip(light, 0, None)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def _jpeg(path: Path, light: AnyArray) -> None:
    samples = np.round(_srgb(np.clip(light, 0, 1)) * 255).astype(np.uint8)
    cv2.imwrite(str(path), samples, [cv2.IMWRITE_JPEG_QUALITY, 98])


def _coloured(scale: float) -> AnyArray:
    return _unclipped(scale)[..., None] * np.array([1.0, 0.8, 0.6])


def _one_brighter(frames: AnyArray, index: int, factor: float) -> AnyArray:
    """Return images of which one was taken under a stronger light."""
    frames = frames.copy()
    frames[index] *= factor
    return frames


def _one_overexposed(folder: Path) -> Outcome:
    """One image in 12 is clipped; its light is known to be stronger."""
    source = _u16(folder, _one_brighter(_unclipped(0.6), 4, 3.0), 16000, full=20000)
    strengths = np.where(np.arange(12) == 4, 3.0, 1.0)[:, None]
    (source / "l.lp").unlink()
    lights = source.with_name("lights.json")
    write_lights(
        lights,
        Lights(
            directions=directions(12),
            intensities=np.repeat(strengths, 3, axis=1),
            ids=tuple(f"IMG_{i + 1:04d}" for i in range(12)),
        ),
    )
    return _stated(source, "--lights", lights)


def _session(folder: Path) -> Outcome:
    """A session whose sensor is full at 3800 of 4095."""
    reading = read_import(_u16(folder, _unclipped(2.2), 3800, full=4000))
    session = folder / "session"
    # As a rig records it: 12 bits, of which the sensor does not use the last.
    import_frames(replace(reading, white_level=4095.0), session)
    return _stated(session)


@later
def _alarm(folder: Path, frames: Any, clip: Any = 65535, *, byte: bool = False) -> Outcome:
    """No white level must be found where nothing is clipped."""
    source = read_source((_u8 if byte else _u16)(folder, frames, clip))
    codes = [each.code for each in source.warnings if each.code in _FOUND]
    text = f"white level {source.white_level:g}, {', '.join(codes) or 'no notice'}"
    return Outcome("wrong" if codes else "right", text)


def _no_alarm(folder: Path) -> Outcome:
    source = _u16(folder, _unclipped(0.9), 65535)
    answer, error = error_of(source)
    found = [code for code, _ in answer.notices if code in _FOUND]
    return Outcome("wrong", f"{found[0]}") if found else judge(answer, error)


def _card(*, noise: float, elevations: str) -> AnyArray:
    """Return images of a flat white card next to a darker relief."""
    relief = _unclipped(0.5, noise=noise)
    ups = np.full(12, 0.8) if elevations == "equal" else 0.6 + 0.02 * np.arange(12)
    frames = relief.copy()
    frames[:, :20] = ups[:, None, None]
    return frames + np.random.default_rng(1).normal(0, noise, frames.shape)


def _tablet() -> AnyArray:
    """Return noiseless images of a flat tablet with rounded edges, one light above it."""
    y, x = np.mgrid[:H, :W]
    far = np.maximum(np.hypot((x - W / 2) / 50, (y - H / 2) / 40), 0.7) - 0.7
    normals = np.stack([-(x - W / 2) * far / 20, (y - H / 2) * far / 20, np.ones((H, W))], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    lights = directions(12).copy()
    lights[3] = (0, 0, 1)
    return np.clip(np.einsum("hwc,nc->nhw", normals, lights), 0, None) * 0.8


def _low_relief() -> AnyArray:
    """Return noiseless images of a flat coin: its samples under the light above it are equal."""
    y, x = np.mgrid[:H, :W]
    far = np.maximum(np.hypot((x - W / 2) / 50, (y - H / 2) / 40), 0.7) - 0.7
    right = 0.05 * np.sin(x / 5) + (x - W / 2) * far / 20
    up = 0.05 * np.cos(y / 5) - (y - H / 2) * far / 20
    normals = np.stack([right, up, np.ones((H, W))], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    lights = directions(12).copy()
    lights[3] = (0, 0, 1)
    return np.clip(np.einsum("hwc,nc->nhw", normals, lights), 0, None) * 0.8


_HOT = np.arange(5), np.arange(5)


def _hot() -> AnyArray:
    frames = _unclipped(2.2)
    frames[:, *_HOT] = 2.0
    return frames


def _clip_with_hot() -> AnyArray:
    most = np.full((H, W), 28000)
    most[_HOT] = 65535
    return most


def _frequent() -> AnyArray:
    """Return noisy images with their largest value in 200 samples of a label."""
    frames = _unclipped(0.6)
    frames[:, :10, :20] = 0.75
    return frames


_RNG = np.random.default_rng(5)
_RAMP = np.linspace(100, 500, H).round()
_COLUMNS = _RNG.normal(0, 6, W).round(1)
_T44 = np.arange(16).reshape(4, 4) * 20 + 200
_T22 = np.array([[256, 306], [356, 406]])
_T66 = np.arange(36).reshape(6, 6) * 10 + 100


def _case(name: str, right: str, run: Run, *, listed: bool = True) -> Case:
    return Case(name, 1, right, run, listed)


def _further(name: str, right: str, run: Run) -> Case:
    return _case(name, right, run, listed=False)


def _dng(
    name: str, *, listed: bool = True, right: str = "levels of each sample", **given: Any
) -> Case:
    return _case(name, right, lambda folder: _read_dng(folder, **given), listed=listed)


CASES = (
    _dng("dng_plain", listed=False, right="control"),
    _dng("dng_black44", levels=_T44),
    _dng("dng_delta_ramp", levels=0, rows=_RAMP),
    _dng("dng_active_black_11", levels=_T22, origin=(1, 1)),
    _dng("dng_active_black_01", levels=_T22, origin=(0, 1)),
    _dng("dng_active_black_30", levels=_T22, origin=(3, 0)),
    _dng("dng_xtrans_black66", pattern=_XTRANS, levels=_T66),
    _dng("dng_quad_bayer", pattern=_QUAD, right="true pattern of 4 x 4"),
    _dng("dng_mono", pattern=None, right="no colour filter"),
    _dng("dng_delta_columns", levels=_T22, columns=_COLUMNS, listed=False),
    _dng(
        "dng_delta_both_odd", levels=_T44, rows=_RAMP, columns=_COLUMNS, origin=(1, 3), listed=False
    ),
    _dng("dng_black44_subifd", levels=_T44, thumbnail=True, listed=False),
    _dng("dng_black44_big_endian", levels=_T44, byteorder=">", listed=False),
    _dng("dng_black88", levels=np.arange(64).reshape(8, 8) + 200, listed=False),
    _dng("dng_black14", levels=np.arange(4)[None] * 30 + 200, listed=False),
    _dng("dng_quad_black22_odd", pattern=_QUAD, levels=_T22, origin=(1, 1), listed=False),
    _dng("dng_xtrans_black66_odd", pattern=_XTRANS, levels=_T66, origin=(1, 5), listed=False),
    _dng("dng_mono_ramp", pattern=None, levels=64, rows=_RAMP, origin=(1, 1), listed=False),
    _dng("dng_mono_subifd", pattern=None, levels=_T22, thumbnail=True, listed=False),
    *(
        _case(
            f"dng_{np.dtype(kind).name}",
            "refused: floating-point samples",
            _refused_dng((_plain() / 4095).astype(kind), ["loating-point"], extra=[white(1)]),
        )
        for kind in (np.float32, np.float16)
    ),
    _case(
        "dng_deflate", "refused: Deflate", _refused_dng(_plain(), ["Deflate"], compression="zlib")
    ),
    _further("dng_jpeg_xl", "refused: JPEG XL", _refused_dng(_plain(), ["JPEG XL"], code=52546)),
    _further(
        "dng_float_deflate_subifd",
        "refused: floating-point samples",
        _refused_dng(
            (_plain() / 4095).astype(np.float32),
            ["loating-point"],
            compression="zlib",
            thumbnail=True,
            extra=[white(1)],
        ),
    ),
    _case(
        "dng_linear_raw",
        "refused: all colours in each pixel",
        _refused_dng(
            np.dstack([_plain()] * 3),
            ["demosaiced"],
            pattern=None,
            photometric="linear_raw",
            extra=[white(4095)],
        ),
    ),
    _case("mono_normals", "read as grey", _dngs(_judged, pattern=None)),
    _case("mono_import", "read as grey", _dngs(_imported, pattern=None)),
    _further(
        "mono_clipped",
        "white level found",
        _dngs(_stated, pattern=None, scale=2.2, full=16383, clip=15311),
    ),
    _further("black44_normals", "levels applied", _dngs(_judged, levels=_T44 * 2)),
    _further("black22_normals", "levels applied", _dngs(_judged, levels=[[256, 300], [310, 400]])),
    _further("black22_import", "levels applied", _dngs(_imported, levels=[[256, 300], [310, 400]])),
    _further("ramp_import", "levels applied", _dngs(_imported, pattern=None, levels=0, rows=_RAMP)),
    _case("raw_clip_15311", "white level found", _dngs(_stated, scale=1.7, full=16383, clip=15311)),
    _case(
        "raw_clip_red",
        "white level of red found",
        _dngs(_stated, scale=1.3, full=16383, clip=[[6000, 16383], [16383, 16383]]),
    ),
    _further(
        "raw_clip_greens_differ",
        "white level of each green found",
        _dngs(_stated, scale=1.7, full=16383, clip=[[15000, 15311], [14900, 15000]]),
    ),
    _further(
        "raw_white_of_colours",
        "stated level of each colour used",
        _dngs(
            _judged,
            scale=1.3,
            full=16383,
            clip=[[6000, 16383], [16383, 9000]],
            whites=(6000, 16383, 9000),
        ),
    ),
    _further(
        "raw_clip_import", "white level found", _dngs(_imported, scale=1.7, full=16383, clip=15311)
    ),
    _case(
        "float_clip_035",
        "white level found",
        lambda folder: _stated(_series(folder, _unclipped(0.8), _floats(0.35), ".tif")),
    ),
    _further(
        "float16_clip",
        "white level found",
        lambda folder: _stated(_series(folder, _unclipped(2.2), _floats(0.81, np.float16), ".tif")),
    ),
    _case("u16_clip_3500", "white level found", _pngs(_unclipped(2.2), 3500, full=3500)),
    _further("u16_low_bits", "control: 12 bits, as today", _pngs(_unclipped(2.2), 4095, full=4095)),
    _case(
        "u8_clip_250",
        "white level found",
        lambda folder: _stated(_u8(folder, _unclipped(2.2), 250), "--gamma", "linear", limit=0.5),
    ),
    _further(
        "u8_srgb_clip_250",
        "white level found",
        lambda folder: _stated(
            _u8(folder, _srgb(_unclipped(2.2)), 250), "--gamma", "srgb", limit=0.5
        ),
    ),
    _further(
        "jpg_clip_237",
        "white level found",
        lambda folder: _stated(
            _series(folder, np.minimum(_unclipped(1.6), 0.85), _jpeg, ".jpg"), limit=0.4
        ),
    ),
    _case(
        "rgb_clip_red",
        "white level of red found",
        _pngs(_coloured(0.95), np.array([30000, 65535, 65535])),
    ),
    _further(
        "high_bits_clip",
        "white level found",
        lambda folder: _stated(
            _series(
                folder,
                _unclipped(2.2),
                lambda path, light: cv2.imwrite(
                    str(path), np.clip(np.round(light * 4000), 0, 3900).astype(np.uint16) << 4
                ),
                ".png",
            )
        ),
    ),
    _further("one_image_clipped", "white level found", _one_overexposed),
    _further("session_clip_3800", "white level found", _session),
    _further(
        "blown_background",
        "white level found",
        _pngs(np.where(INSIDE, _unclipped(2.2), 2.0), 50000, full=50000),
    ),
    _further("clean", "control: no notice", _no_alarm),
    _further("clean_noiseless", "control: no notice", _alarm(_unclipped(0.9, noise=0))),
    _further(
        "clean_noiseless_8_bits",
        "control: no notice",
        _alarm(_unclipped(0.9, noise=0), 255, byte=True),
    ),
    _further("card_noisy", "control: no notice", _alarm(_card(noise=0.002, elevations="equal"))),
    _further("card_noiseless", "control: no notice", _alarm(_card(noise=0, elevations="equal"))),
    _further(
        "card_8_bits",
        "control: no notice",
        _alarm(_card(noise=0.001, elevations="different"), 255, byte=True),
    ),
    _further(
        "clip_below_hot_pixels", "white level found", _pngs(_hot(), _clip_with_hot(), full=30000)
    ),
    _further("low_relief_8_bits", "control: no notice", _alarm(_low_relief(), 255, byte=True)),
    _further("tablet_noiseless", "control: no notice", _alarm(_tablet())),
    _further("frequent_maximum", "control: no notice", _alarm(_frequent())),
)
