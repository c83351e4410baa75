"""``sgp simulate``: record scenes on the simulated rig, with their ground truth."""

from __future__ import annotations

import shutil
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

import acquisition
import rig
import simulator
from sgp.cli.console import Stages, with_progress
from sgp.cli.exit import UsageError
from sgp.cli.options import Leds, Memory, Positive, Seed, image_size
from sgp.results import Result, SimulateMetrics, check_file, check_folder, provenance
from sgp.sessions import Rendered, metered_exposures, pixels_in_view, record_simulated, rendered
from sgp.stages import Stopwatch

_SHEET_SIZE = (320, 256)
# Where readers of a session find what is true of it.
_TRUTH = Path("derived") / "truth"


def simulate(
    scene: str,
    *,
    out: Path | None = None,
    led_count: Leds | None = None,
    lights: Annotated[Leds | None, Parameter(show=False)] = None,
    size: str | None = None,
    seed: Seed | None = None,
    exposure_us: list[Positive] | None = None,
    noise: Annotated[bool, Parameter(negative="--no-noise")] = True,
    sharp: bool = False,
    memory: Memory | None = None,
    layout: Annotated[Literal["session", "diligent"], Parameter(name="format")] = "session",
    sheet: Path | None = None,
) -> Result:
    """Record a simulated scene, and save its ground truth with the recording.

    The recording uses the simulated rig and the same writer as a capture. The ground truth
    (normals, height, albedo, shadows, lights, camera, spheres, noise) is saved in derived/truth.

    For example:

        sgp simulate coin --out recordings/coin --size 1280x1024
        sgp simulate scene.toml --out owl --format diligent
        sgp simulate list --sheet scenes.png

    Parameters
    ----------
    scene
        Name of a scene, scene file (.toml), or `list` to list the names.
    out
        New folder for the recording.
    led_count
        Number of LEDs; default: as in the scene, else 36.
    lights
        Earlier spelling of --led-count.
    size
        Size of the image in pixels, for example 640x512; the width of the field does not change.
    seed
        Seed of surface, paint and spread of the lights (default: the seed in the scene file, else
        0), and of the noise (default: 0).
    exposure_us
        Exposure time in microseconds; repeat the option for each bracket; default: metered.
    noise
        --no-noise disables the noise: frames then differ from the ground truth by rounding only.
    sharp
        Simulate a lens without blur, to compare images with closed forms. A scene file states this
        in its [lens] table.
    memory
        Memory to use, for example 2G; default: half of what is free. Images that need more are
        rendered in bands of rows, with equal results, and kept on the disk of --out for a while.
    layout
        session, or diligent: 16-bit PNGs with light_directions.txt, mask.png and Normal_gt.mat.
    sheet
        With `list`: contact sheet (.png) to write, with each scene lit, as normals and with its
        shadows.
    """
    if scene == "list":
        return _list(sheet, out)
    if out is None:
        raise UsageError("--out is missing: give a folder for the recording")
    if sheet is not None:
        raise UsageError("--sheet draws all scenes: use it with `sgp simulate list` only")
    if lights is not None and led_count is not None:
        raise UsageError("--lights is the earlier spelling of --led-count: give only one")
    leds = led_count or lights
    check_folder(out)
    watch = Stopwatch()
    chosen, files = _scene(scene, leds, size, seed, sharp=sharp)
    if layout == "diligent" and chosen.lens.cfa is not None:
        raise UsageError(
            "--format diligent does not support cameras with a colour mosaic: record a session"
        )
    with ExitStack() as kept:
        with watch.stage("render"):
            rendering = kept.enter_context(rendered(chosen, out.parent, memory))
        exposures = metered_exposures(rendering) if exposure_us is None else tuple(exposure_us)
        if layout == "diligent":
            exposures = exposures[:1]  # the layout has one image per light
        height, width = chosen.lens.size
        in_view = pixels_in_view(rendering)
        lit = rig.pluralize(len(chosen.lights), "light")
        times = " and ".join(f"{exposure:g} us" for exposure in exposures)
        result = Result(
            metrics=SimulateMetrics(
                lights=len(chosen.lights),
                width=width,
                height=height,
                exposures_us=list(exposures),
                pixels=in_view.get("mask", 0),
                spheres=sum(name.startswith("sphere_") for name in in_view),
                seconds=watch.seconds,
            ),
            summary=[f"{scene}: {lit}, {width} x {height} pixels, exposure time {times}"],
            inputs=files,
        )
        if dead := chosen.lamps.dead:
            text = f"LED {', '.join(map(str, dead))} skipped: dead in the scene"
            result.warnings.append(rig.Notice("leds-skipped", text, severity="info"))

        def recorded(folder: Path) -> acquisition.Session:
            return record_simulated(
                rendering,
                folder,
                exposures_us=exposures,
                object_name=Path(scene).stem,
                seed=seed or 0,
                noisy=noise,
            )

        parameters = {
            "scene": scene, "lights": leds, "size": size, "seed": seed, "exposures_us": exposures,
            "noise": noise, "noise_seed": seed or 0, "sharp": sharp, "format": layout,
        }  # fmt: skip

        def save_truth(place: Path) -> dict[str, Path]:
            with watch.stage("truth"):
                return simulator.save_truth(
                    place,
                    rendering,
                    exposures_us=exposures,
                    facts=provenance("sgp simulate", parameters, files),
                )

        if layout == "diligent":
            with acquisition.files.staged(out) as building, watch.stage("record"):
                session = recorded(building / "recording")
                written = _export_diligent(session, building, rendering, result)
                shutil.rmtree(session.folder)
            saved = save_truth(out / "truth")
            result.outputs |= {"folder": out} | {path.stem: out / path.name for path in written}
            result.summary.append(
                f"{out}: {rig.pluralize(len(chosen.lights), 'image')} in the DiLiGenT layout"
            )
        else:
            with watch.stage("record"):
                session = recorded(out)
            saved = save_truth(out / _TRUTH)
            result.outputs["session"] = out
            frames = rig.pluralize(len(session.frames), "frame")
            result.summary.append(f"{out}: {frames}, ground truth in {out / _TRUTH}")
        result.outputs |= {f"truth.{name}": path for name, path in saved.items()}
        return result


def _scene(
    name: str, leds: int | None, size: str | None, seed: int | None, *, sharp: bool
) -> tuple[simulator.Scene, list[Path]]:
    pixels = None if size is None else image_size("--size", size)
    if name.endswith(".toml"):
        if sharp:
            raise UsageError(f"--sharp: write sharp = true in the [lens] table of {name}")
        return simulator.read_scene(name, leds=leds, size=pixels, seed=seed), [Path(name)]
    if name not in simulator.SCENES:
        raise UsageError(
            f"there is no scene {name}: `sgp simulate list` lists the names; the name of a scene "
            "file must end in .toml"
        )
    options: dict[str, Any] = {"sharp": sharp} | ({} if leds is None else {"leds": leds})
    if pixels is not None:
        options |= {"width": pixels[0], "height": pixels[1]}
    return simulator.scene_named(name, seed=seed or 0, **options), []


def _export_diligent(
    session: acquisition.Session, folder: Path, rendering: Rendered, result: Result
) -> tuple[Path, ...]:
    """Export a recording with its true mask and normals, and report what the layout loses."""
    if "mask" in pixels_in_view(rendering):
        place = session.folder / _TRUTH
        acquisition.make_folder(place)
        acquisition.write_mask(place / "mask.png", rendering.maps["mask"])
        acquisition.write_exr(place / "normals.exr", rendering.maps["normals"])
    export = acquisition.exports.prepare_export(
        session.folder, "diligent", values="linear", lights=rendering.scene.lights
    )
    result.warnings += export.warnings
    return with_progress(export.write_into)(folder)


def _list(sheet: Path | None, out: Path | None) -> Result:
    if out is not None:
        raise UsageError("`sgp simulate list` records nothing: leave out --out")
    widest = max(map(len, simulator.SCENES))
    result = Result(
        metrics={"scenes": dict(simulator.SCENES)},
        summary=[f"{name:<{widest}}  {text}" for name, text in simulator.SCENES.items()],
    )
    if sheet is not None:
        from sgp.pictures import write_contact_sheet

        check_file(sheet, ".png", force=True)
        width, height = _SHEET_SIZE
        renderings = {}
        with Stages() as progress:
            for done, name in enumerate(simulator.SCENES, 1):
                renderings[name] = simulator.render(
                    simulator.scene_named(name, width=width, height=height)
                )
                progress("scenes", done, len(simulator.SCENES))
        write_contact_sheet(sheet, renderings)
        result.outputs["sheet"] = sheet
    return result
