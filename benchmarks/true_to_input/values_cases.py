"""Values that keep their errors: lights, standard deviations, normal maps, known heights."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
from true_to_input.case import Answer, Case, Outcome, judge, sgp

from rig.arrays import Bool, Floating, Unsigned

# --- lights in a session, and of a rig file


def _recorded(folder: Path, lights: Callable[..., object] | None) -> tuple[Path, object, object]:
    """Record the simulated coin under 12 LEDs; return the session, its lights and the rendering."""
    from acquisition import Calibrations, CapturePlan, Labels, record
    from simulator import open_rig_seeing, render, scene_named

    view = render(scene_named("coin", width=96, height=78, leds=12))
    given = None if lights is None else lights(view.truth.lights)
    with open_rig_seeing(view, realtime=False, camera="inside") as rig:
        plan = CapturePlan(leds="0-11", exposures_us=(20_000.0,))
        calibrations = Calibrations(camera_model=view.truth.camera, lights=given)
        record(rig, plan, folder / "session", Labels(), calibrations=calibrations)
    return folder / "session", given, view


def _stored_lights(folder: Path, lights: Callable[..., object]) -> Outcome:
    """Lights read from a session are the given ones, as `lights.json` holds them."""
    from acquisition import read_source, write_lights

    session, given, _ = _recorded(folder, lights)
    stored = read_source(session).lights
    texts = []
    for name, value in (("given", given), ("stored", stored)):
        write_lights(folder / f"{name}.json", value)
        texts.append((folder / f"{name}.json").read_text())
    if texts[0] == texts[1]:
        return Outcome("right", "all values, errors and the record of the calibration are kept")
    first, second = (json.loads(text) for text in texts)
    lost = sorted(set(first["lights"][0]) - set(second["lights"][0]))
    lost += sorted(set(first) - set(second))
    return Outcome("wrong", f"lost: {', '.join(lost) or 'digits'}")


def _near(lights, **errors):
    from acquisition import LightErrors

    return replace(lights, errors=LightErrors(**errors))


def _calibrated(lights):
    from acquisition import Setup
    from acquisition.values import Calibrated, UsedSphere

    setup = Setup("another rig", "Maker", "M2", "40012345")
    sphere = UsedSphere((40.5, 30.25), 12.5, (1.0, 2.0, 3.0), 5.0)
    return replace(
        lights, calibrated=Calibrated(datetime(2026, 3, 4, 5, 6, 7, tzinfo=UTC), setup, (sphere,))
    )


_MM2 = np.tile(np.eye(3) * 4.0, (12, 1, 1))


def _gaps(lights):
    covariances = _MM2.copy()
    covariances[3] = np.nan
    return _near(lights, covariances=covariances, spheres=np.array([2] * 3 + [0] + [4] * 8))


def _directions(lights):
    return _near(lights.distant(), covariances=np.tile(np.diag([1e-4, 2e-4]), (12, 1, 1)))


def _strengths(lights):
    return _near(
        lights,
        intensity_std=np.tile([0.01, 0.02, 0.03], (12, 1)),
        axis_std_deg=np.full(12, 1.5),
        mu_std=np.full(12, 0.1),
        residual_px=np.linspace(0.05, 0.2, 12),
    )


def _error_bars(folder: Path) -> Outcome:
    """Error bars with the lights of the session are those with the same lights from a file."""
    from acquisition import read_source
    from processing import reconstruct

    session, lights, _ = _recorded(folder, lambda lights: _near(lights, covariances=_MM2))
    common = [
        float(np.nanmedian(reconstruct(source, surface=False).uncertainty.common_sigma_deg))
        for source in (read_source(session), read_source(session, lights=lights))
    ]
    kind = "right" if abs(common[0] / common[1] - 1) < 0.01 else "wrong"
    return Outcome(kind, f"common to all pixels {common[0]:.3f} deg, from a file {common[1]:.3f}")


def _changed_rig(folder: Path) -> Outcome:
    session, _, _ = _recorded(folder, _calibrated)
    answer = sgp("normals", session, "--out", folder / "out")
    return judge(answer, codes=("lights-of-another-rig",))


def _exported(folder: Path, layout: str) -> Outcome:
    """An export that is read or imported again has the lights of the session."""
    from acquisition import import_frames, read_source
    from acquisition.exports import prepare_export

    session, lights, _ = _recorded(
        folder, lambda lights: _calibrated(_near(lights, covariances=_MM2))
    )
    prepare_export(session, layout, lights=lights).write(folder / "images")
    source = read_source(folder / "images")
    import_frames(source, folder / "imported")
    lost = [
        name
        for name, read in (("export", source), ("import", read_source(folder / "imported")))
        if read.lights.errors is None or read.lights.calibrated is None
    ]
    return Outcome("wrong" if lost else "right", f"lost in: {', '.join(lost) or 'nothing'}")


def _rig_file(folder: Path, view, *, positions: bool = True, sigma: float | None = None) -> Path:
    places = np.round(view.truth.lights.positions_mm, 3).tolist()
    lines = ['name = "simulated"', 'driver = "simulated"', "leds = 12"]
    lines += [f"led_positions_mm = {places}"] if positions else []
    lines += [] if sigma is None else [f"led_positions_sigma_mm = {sigma}"]
    path = folder / "desk.toml"
    path.write_text("\n".join(lines) + "\n")
    return path


def _angle(folder: Path, answer: Answer, view) -> float | None:
    if answer.code:
        return None
    found, seen = _png_normals(folder / "out" / "normals.png")
    seen &= view.truth.mask
    found, truth = found[seen], view.truth.normals[seen]
    crossed, along = np.linalg.norm(np.cross(found, truth), axis=-1), (found * truth).sum(-1)
    return float(np.rad2deg(np.arctan2(crossed, along)).mean())


def _exr(path: Path) -> Floating:
    """Return the first channel."""
    import OpenImageIO

    return OpenImageIO.ImageBuf(str(path)).get_pixels(OpenImageIO.FLOAT)[..., 0]


def _png_normals(path: Path) -> tuple[Floating, Bool]:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    return image[..., 2::-1] / 65535 * 2 - 1, image[..., 3] > 0


def _rig_lights(folder: Path, *options: object, sigma: float | None = 2.0) -> Outcome:
    session, _, view = _recorded(folder, None)
    file = _rig_file(folder, view, sigma=sigma)
    out = folder / "out"
    words = ("--lights", "rig", "--rig", file, *options, "--out", out)
    answer = sgp("normals", session, *words)
    # With the true lights it is 4.05 deg: the images are small.
    figure = _angle(folder, answer, view)
    if answer.code:
        return Outcome("wrong", answer.message)
    return judge(answer, figure, limit=4.6, codes=("lights-of-rig",))


def _rig_sigma(folder: Path) -> Outcome:
    """The stated error of the positions is in the error bars."""
    session, _, view = _recorded(folder, None)
    commons = []
    for sigma in (2.0, 20.0):
        file = _rig_file(folder, view, sigma=sigma)
        out = folder / "out"
        words = ("--lights", "rig", "--rig", file, "--out", out, "--force")
        answer = sgp("normals", session, *words)
        if answer.code:
            return Outcome("wrong", answer.message)
        commons.append(answer.values["metrics"]["normal_sigma_common_deg"])
    kind = "right" if commons[1] > commons[0] + 0.1 else "wrong"
    return Outcome(kind, f"common to all pixels {commons[0]:.3f} and {commons[1]:.3f} deg")


def _rig_without_positions(folder: Path) -> Outcome:
    session, _, view = _recorded(folder, None)
    file = _rig_file(folder, view, positions=False)
    answer = sgp("normals", session, "--lights", "rig", "--rig", file, "--out", folder / "out")
    return judge(answer, names=("led_positions_mm",))


# --- standard deviations of normals


def _largest_sigma(folder: Path, count: int, noise: float) -> Outcome:
    """`sgp surface --sigma` reads the standard deviations that `sgp normals` wrote."""
    from true_to_input.relief import MASK, directions, images

    source = folder / "src"
    source.mkdir()
    lights = directions(count)
    for i, image in enumerate(images(lights, noise=noise)):
        cv2.imwrite(str(source / f"{i:02d}.png"), np.round(image * 65535).astype(np.uint16))
    cv2.imwrite(str(source / "mask.png"), MASK)
    np.savetxt(folder / "lights.txt", lights, fmt="%.6f")
    words = ("--lights", folder / "lights.txt", "--out", folder / "n")
    answer = sgp("normals", source, *words)
    if answer.code:
        return Outcome("wrong", answer.message)
    file = folder / "n" / "normal_sigma_deg.exr"
    largest = float(np.nanmax(_exr(file)))
    answer = sgp("surface", folder / "n", "--sigma", file, "--out", folder / "s")
    if answer.code:
        return Outcome("wrong", f"largest {largest:.0f} deg: {answer.message}")
    return Outcome("right" if largest <= 98.2 else "wrong", f"largest {largest:.1f} deg, read")


# --- normal maps of other programs

_Y, _X = np.mgrid[:150, :200]
_XS, _YS = _X - 99.5, 74.5 - _Y


def _relief(x: Floating, y: Floating) -> Floating:
    bump = 12 * np.exp(-((x - 20) ** 2 + (y + 10) ** 2) / 1500)
    return bump + 6 * np.sin(x / 17 + y / 29) + 4 * np.cos(y / 13 - x / 40)


def _flat(x: Floating, y: Floating) -> Floating:
    return 0.0 * x


def _shallow(x: Floating, y: Floating) -> Floating:
    return 0.15 * _relief(x, y)


def _half_flat(x: Floating, y: Floating) -> Floating:
    """A button on a flat ground."""
    r2 = ((x - 10) ** 2 + (y + 5) ** 2) / 45**2
    return 12 * np.clip(1 - r2, 0, None) ** 2


def _normals(height: Callable[[Floating, Floating], Floating]) -> Floating:
    e = 1e-4
    right = (height(_XS + e, _YS) - height(_XS - e, _YS)) / 2 / e
    up = (height(_XS, _YS + e) - height(_XS, _YS - e)) / 2 / e
    normals = np.stack([-right, -up, np.ones_like(right)], -1)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def _rounded(n: Floating) -> Unsigned:
    return np.clip(np.floor(n * 127.5 + 128), 0, 255).astype(np.uint8)


def _around_128(n: Floating) -> Unsigned:
    return np.clip(np.floor(n * 127 + 128.5), 0, 255).astype(np.uint8)


def _halved_to_128(n: Floating) -> Unsigned:
    """Code 128 for 0, and 128 codes for 1, cut at 255."""
    return np.clip(np.floor(n * 128 + 128.5), 0, 255).astype(np.uint8)


def _cut_off(n: Floating) -> Unsigned:
    """Rounded down, as a cast to an integer does."""
    return np.clip(n * 127.5 + 127.5, 0, 255).astype(np.uint8)


def _around_127(n: Floating) -> Unsigned:
    return np.clip(np.rint(n * 127 + 127), 0, 254).astype(np.uint8)


def _promoted(n: Floating) -> Unsigned:
    """An 8-bit map around 128 that was saved with 16 bits."""
    return _around_128(n).astype(np.uint16) * 257


def _shifted(n: Floating) -> Unsigned:
    return _around_128(n).astype(np.uint16) * 256


def _sixteen(n: Floating) -> Unsigned:
    return np.clip(np.rint(n * 32767 + 32768), 0, 65535).astype(np.uint16)


def _two_channels(blue: int) -> Callable[[Floating], Unsigned]:
    def coded(n: Floating) -> Unsigned:
        codes = _rounded(n)
        codes[..., 2] = blue
        return codes

    return coded


def _power(exponent: float) -> Callable[[Floating], Unsigned]:
    def coded(n: Floating) -> Unsigned:
        return np.rint(((n + 1) / 2) ** exponent * 255).astype(np.uint8)

    return coded


def _srgb(n: Floating) -> Unsigned:
    light = np.clip((n + 1) / 2, 0, 1)
    curved = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.rint(curved * 255).astype(np.uint8)


def _linearised(n: Floating) -> Floating:
    """Encoded values that a renderer took for sRGB colours."""
    values = (n + 1) / 2
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def _encoded_without_z(n: Floating) -> Floating:
    return (n + 1) / 2 * [1, 1, 0]


def _x_in_alpha(n: Floating) -> Unsigned:
    """DXT5nm, which is written as blue, green, red, alpha; the caller turns the channels round."""
    codes = _rounded(n)
    white = np.full(n.shape[:2], 255, np.uint8)
    return np.stack([codes[..., 0], white, codes[..., 1], white], -1)


def _map_case(
    folder: Path,
    height: Callable[[Floating, Floating], Floating],
    coded: Callable[[Floating], Unsigned],
    *,
    limit: float = 0.08,
    codes: tuple[str, ...] = (),
    names: tuple[str, ...] = ("curve",),
    down: bool = False,
    suffix: str = ".png",
    memory: bool = False,
) -> Outcome:
    """Integrate a map; the figure is the rms error of the height in pixels."""
    normals = _normals(height) * ([1, -1, 1] if down else [1, 1, 1])
    path = folder / f"map{suffix}"
    quality = [cv2.IMWRITE_JPEG_QUALITY, 92] if suffix == ".jpg" else []
    samples = coded(normals)[..., ::-1]
    if suffix == ".npy":
        np.save(path, samples[..., ::-1].astype(np.float32))
    else:
        cv2.imwrite(str(path), samples, quality)
    words = ["--green", "down"] if down else []
    words += ["--memory", "500MB"] if memory else []
    answer = sgp("surface", path, *words, "--out", folder / "out")
    if answer.code:
        return judge(answer, names=names)
    found = _exr(folder / "out" / "height.exr")
    rms = float(np.nanstd(found - height(_XS, _YS)))
    return judge(answer, rms, limit=limit, unit="px rms", codes=codes, enough=codes)


# --- known heights

_ROWS = [(20, 30), (150, 40), (60, 120), (180, 130), (100, 70)]


def _prior_case(
    folder: Path,
    changed: Callable[[Floating], Floating],
    *,
    codes: tuple[str, ...] = (),
    names: tuple[str, ...] = (),
    places: list[tuple[int, int]] = _ROWS,
    text: str = "",
) -> Outcome:
    """Hold a relief at known heights, 7 mm higher; the figure is the error of the mean, in mm."""
    truth = _relief(_XS, _YS) * 0.1 + 7
    normals = _normals(_relief)
    codes16 = np.rint((normals + 1) / 2 * 65535).astype(np.uint16)
    cv2.imwrite(str(folder / "n16.png"), codes16[..., ::-1])
    heights = changed(np.array([truth[y, x] for x, y in places]))
    lines = ["x_px,y_px,height_mm"]
    lines += [f"{x},{y},{h:.4f}" for (x, y), h in zip(places, heights, strict=True)]
    (folder / "prior.csv").write_text("\n".join(lines) + "\n")
    words = ("--prior", folder / "prior.csv", "--pixel-mm", 0.1, "--out", folder / "out")
    answer = sgp("surface", folder / "n16.png", *words)
    if answer.code:
        return judge(answer, names=names)
    found = _exr(folder / "out" / "height.exr")
    off = float(abs(np.nanmean(found - truth)) + np.nanstd(found - truth))
    outcome = judge(answer, off, limit=0.05, unit="mm", codes=codes, enough=codes)
    stated = " ".join(text for _, text in answer.notices)
    if codes and outcome.kind == "applied and stated" and text not in stated:
        return Outcome("vague", f"{outcome.text}: does not name {text}")
    return outcome


def _with(index: int, value: float) -> Callable[[Floating], Floating]:
    def changed(heights: Floating) -> Floating:
        heights = heights.copy()
        heights[index] += value
        return heights

    return changed


_RNG = np.random.default_rng(5)
_MANY = [(int(x), int(y)) for x, y in _RNG.integers(5, 145, (20, 2))]


def _three_wrong(heights: Floating) -> Floating:
    return heights + np.isin(np.arange(len(heights)), [2, 9, 15]) * np.array([4.0])


def _maps(name: str, right: str, *given: object, listed: bool = False, **options: object) -> Case:
    return Case(name, 2, right, lambda folder: _map_case(folder, *given, **options), listed)


def _lights(name: str, lights: Callable[..., object], *, listed: bool = False) -> Case:
    return Case(name, 2, "kept", lambda folder: _stored_lights(folder, lights), listed)


def _priors(name: str, right: str, *given: object, listed: bool = False, **options) -> Case:
    return Case(name, 2, right, lambda folder: _prior_case(folder, *given, **options), listed)


_STATED = {"codes": ("normals-encoding",)}
_NAMED = {"codes": ("prior-outliers",)}
_DOUBTED = {"codes": ("prior-doubtful",)}

CASES = (
    Case("session-error-bars", 2, "those of the same lights in a file", _error_bars),
    _lights("session-covariances", lambda one: _near(one, covariances=_MM2), listed=True),
    _lights("session-calibrated", _calibrated, listed=True),
    Case("session-changed-rig", 2, "the other rig is named", _changed_rig),
    _lights("session-directions", _directions),
    _lights("session-strengths", _strengths),
    _lights("session-gaps", _gaps),
    _lights("session-plain", lambda one: one),
    *(
        Case(f"{layout}-and-back", 2, "kept", lambda folder, layout=layout: _exported(
            folder, layout), listed=False)
        for layout in ("diligent", "lp", "alicevision")
    ),
    Case("sigma-5-lights", 2, "at most that of a uniform direction",
         lambda folder: _largest_sigma(folder, 5, 0.1)),
    Case("sigma-8-lights", 2, "at most that of a uniform direction",
         lambda folder: _largest_sigma(folder, 8, 0.1), listed=False),
    Case("rig-lights", 2, "used, equal strengths stated", _rig_lights),
    Case("rig-lights-estimated", 2, "used, strengths estimated",
         lambda folder: _rig_lights(folder, "--semi-calibrated"), listed=False),
    Case("rig-lights-sigma", 2, "in the error bars", _rig_sigma),
    Case("rig-without-positions", 2, "refused", _rig_without_positions, listed=False),
    _maps("flat-128", "flat", _flat, _around_128, listed=True, **_STATED),
    _maps("relief-128", "centre 128", _relief, _around_128, listed=True, **_STATED),
    _maps("relief-127.5", "as before", _relief, _rounded, limit=0.02),
    _maps("relief-128-green-down", "centre 128", _relief, _around_128, down=True, **_STATED),
    _maps("relief-128-bands", "centre 128", _relief, _around_128, memory=True, **_STATED),
    _maps("relief-128-scale-128", "centre 128", _relief, _halved_to_128, **_STATED),
    _maps("relief-128-jpeg", "centre 128", _relief, _around_128, suffix=".jpg", **_STATED),
    _maps("relief-127.5-jpeg", "as before", _relief, _rounded, suffix=".jpg"),
    _maps("shallow-128", "centre 128", _shallow, _around_128, **_STATED),
    _maps("shallow-127.5", "as before", _shallow, _rounded),
    _maps("half-flat-128", "centre 128", _half_flat, _around_128, **_STATED),
    _maps("half-flat-127.5", "flat ground", _half_flat, _rounded, **_STATED),
    _maps("flat-127", "flat", _flat, _cut_off, **_STATED),
    _maps("relief-cut-off", "centre 127", _relief, _cut_off, **_STATED),
    _maps("relief-127", "centre 127", _relief, _around_127, **_STATED),
    _maps("16-bit-of-8-bit-128", "centre 128", _relief, _promoted, **_STATED),
    _maps("16-bit-shifted-128", "centre 128", _relief, _shifted),
    _maps("16-bit-32768", "right", _relief, _sixteen, limit=0.02),
    _maps("two-channels-255", "z from x and y", _relief, _two_channels(255), listed=True,
          **_STATED),
    _maps("two-channels-0", "z from x and y", _relief, _two_channels(0), **_STATED),
    _maps("two-channels-128", "z from x and y", _relief, _two_channels(128), **_STATED),
    _maps("gamma-1.1", "curve undone or refused", _relief, _power(1 / 1.1), listed=True,
          **_STATED),
    _maps("gamma-1-over-1.1", "curve undone or refused", _relief, _power(1.1), **_STATED),
    _maps("srgb", "curve undone or refused", _relief, _srgb, **_STATED),
    _maps("gamma-1.1-shallow", "curve undone", _shallow, _power(1 / 1.1), limit=0.6, **_STATED),
    _maps("gamma-1.1-jpeg", "curve undone", _relief, _power(1 / 1.1), suffix=".jpg", limit=0.3,
          **_STATED),
    _maps("srgb-shallow", "curve undone or refused", _shallow, _srgb, **_STATED),
    _maps("float-linearised", "curve undone", _relief, _linearised, suffix=".npy", **_STATED),
    _maps("float-two-channels-0", "z from x and y", _relief, _encoded_without_z, suffix=".npy",
          **_STATED),
    _maps("two-channels-grey", "flat ground", _half_flat, _two_channels(128), **_STATED),
    _maps("x-in-alpha", "refused by name", _half_flat, _x_in_alpha, names=("DXT5nm",)),
    _priors("prior-ok", "as before", lambda heights: heights, listed=True),
    _priors("prior-outlier", "named and left out", _with(2, 50.0), text="60,120", listed=True,
            **_NAMED),
    _priors("prior-small-outlier", "named and left out", _with(4, 1.0), text="100,70", **_NAMED),
    _priors("prior-three-outliers", "named and left out", _three_wrong, places=_MANY,
            **_NAMED),
    _priors("prior-signs", "named", lambda heights: -heights, listed=True, **_DOUBTED),
    _priors("prior-signs-many", "named", lambda heights: -heights, places=_MANY, **_DOUBTED),
    _priors("prior-um", "named", lambda heights: heights * 1000, **_DOUBTED),
    _priors("prior-inches", "named", lambda heights: heights / 25.4, **_DOUBTED),
    _priors(
        "prior-rows-exchanged", "named", lambda heights: heights[::-1], codes=("prior-missed",)
    ),
)  # fmt: skip
