"""Simulated rigs whose camera sees a rendered scene."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from acquisition import DataError, MissingPathError, NoiseModel
from rig import Rig, RigConfig, RigConfigError
from rig.messages import validation_message
from simulator.bench.wiring import Wiring
from simulator.camera.sensor import ImageFormation
from simulator.rendering.renderer import StoredRendering, render
from simulator.rendering.rendering import Rendering
from simulator.rigs.bench_rig import FRAME_RATE_HZ, CameraKind, simulated_rig
from simulator.scene.lamps import Lamps
from simulator.scene.rig_scenes import SCENES, scene_named
from simulator.scene.scene import Scene
from simulator.scene.scene_file import read_scene
from simulator.scene.scene_parts import build

_Pixels = Annotated[int, Field(ge=1, le=16384)]


class RigOptions(BaseModel):
    """Options of a rig file with the driver ``simulated``.

    Parameters
    ----------
    scene
        Scene under the camera: a name in ``SCENES``, or the path of a scene file, which ends in
        ``.toml`` and has as many LEDs as the rig.
    width, height
        Image size in pixels; give both or neither. The default is 640 x 512, or the size in the
        scene file.
    seed
        Seed of noise, lights, texture and paint. A scene file has its own seed for all of them
        except the noise; this seed overrides it if it is given.
    noise
        If False, frames have no shot noise and no read noise.
    realtime
        If False, the camera does not wait for the exposure time to pass.
    sensor
        Values of `NoiseModel` that differ from the scene's.
    sensor_seed
        Seed of the sensor's fixed pattern.
    lamps
        Values of `Lamps` that differ from the scene's.
    shake_px
        Standard deviation, along each axis, of the image's position in a frame.
    camera
        ``auto``, ``gentl`` or ``inside``; see `simulated_rig`.
    frame_rate_hz
        Maximum frame rate of the camera; not used by the camera ``inside``.
    wiring
        Values of `Wiring`: LEDs that are swapped, double or always on.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    scene: str = next(iter(SCENES))
    width: _Pixels | None = None
    height: _Pixels | None = None
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    noise: bool = True
    realtime: bool = True
    sensor: dict[str, Any] = {}
    sensor_seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    lamps: dict[str, Any] = {}
    shake_px: Annotated[float, Field(ge=0, le=8, allow_inf_nan=False)] = 0.0
    camera: CameraKind = "auto"
    frame_rate_hz: Annotated[float, Field(ge=0.1, le=10_000, allow_inf_nan=False)] = FRAME_RATE_HZ
    wiring: dict[str, Any] = {}


@dataclass(frozen=True)
class BenchFlaws:
    """What is wrong with a simulated bench; the default has no flaw.

    Parameters
    ----------
    wiring
        Wiring faults of the LEDs.
    lamps
        Behaviour of the LEDs over time; None for that of the scene's lamps.
    shake_px
        Standard deviation, along each axis, of the image's position in a frame, 0 to 8 pixels.
    """

    wiring: Wiring = Wiring()
    lamps: Lamps | None = None
    shake_px: float = 0.0


def open_rig(config: RigConfig) -> Rig:
    """Render a scene and open a simulated rig that sees it (driver ``simulated``).

    Parameters
    ----------
    config
        Configuration with the LED count; its ``options`` are those of `RigOptions`.

    Returns
    -------
    Rig
        Open rig; closing it ends the virtual board's process.

    Raises
    ------
    RigConfigError
        If an option is invalid or the scene cannot be built.
    RigError
        If the rig does not start.

    Examples
    --------
    >>> from rig import RigConfig
    >>> from simulator import open_rig
    >>> options = {"scene": "coin", "width": 64, "height": 52, "camera": "inside"}
    >>> with open_rig(RigConfig(name="desk", driver="simulated", leds=4, options=options)) as rig:
    ...     shot = rig.shoot(2, exposure_us=10_000.0)
    >>> shot.led, shot.frame.pixels.shape
    (2, (52, 64))
    """
    try:
        options = RigOptions.model_validate(config.options)
    except ValidationError as error:
        message = validation_message(error, noun="option", known=RigOptions.model_fields)
        raise RigConfigError(f"rig {config.name}: {message}") from error
    try:
        scene = _scene(options, config.leds)
        sensor = build(NoiseModel, asdict(scene.noise) | options.sensor, "sensor")
        lamps = build(Lamps, asdict(scene.lamps) | options.lamps, "lamps")
        wiring = build(Wiring, options.wiring, "wiring")
        rendering = render(replace(scene, noise=sensor, lamps=lamps))
    except (DataError, MissingPathError) as error:
        raise RigConfigError(f"rig {config.name}: {error}") from error
    same = {"seed", "realtime", "sensor_seed", "camera", "frame_rate_hz"}
    return open_rig_seeing(
        rendering,
        config,
        noisy=options.noise,
        flaws=BenchFlaws(wiring=wiring, shake_px=options.shake_px),
        **options.model_dump(include=same),
    )


def _scene(options: RigOptions, leds: int) -> Scene:
    size = None
    if options.width is not None and options.height is not None:
        size = options.width, options.height
    elif (options.width, options.height) != (None, None):
        raise DataError("option 'width' or 'height' is missing: give both or neither")
    if options.scene.endswith(".toml"):
        seed = options.seed if "seed" in options.model_fields_set else None
        return read_scene(options.scene, size=size, seed=seed)
    width, height = size or (640, 512)
    return scene_named(options.scene, width=width, height=height, leds=leds, seed=options.seed)


def open_rig_seeing(
    rendering: Rendering | StoredRendering,
    config: RigConfig | None = None,
    *,
    seed: int = 0,
    noisy: bool = True,
    sensor_seed: int = 0,
    realtime: bool = True,
    camera: CameraKind = "auto",
    frame_rate_hz: float = FRAME_RATE_HZ,
    flaws: BenchFlaws = BenchFlaws(),
) -> Rig:
    """Open a simulated rig that sees a rendering, so that the caller has its ground truth.

    Parameters
    ----------
    rendering
        Rendering that the camera sees; a stored one must stay open.
    config
        Configuration with as many LEDs as the rendering. The default is a rig called ``simulated``
        with the LED positions of the scene.
    seed, noisy, sensor_seed
        See `ImageFormation`.
    realtime, camera, frame_rate_hz
        See `simulated_rig`.
    flaws
        Flaws of the bench; the default has none.

    Returns
    -------
    Rig
        Open rig; closing it ends the virtual board's process.

    Raises
    ------
    RigConfigError
        If the LED counts differ, a dead or wrongly wired LED does not exist, or the camera does
        not support the options.
    RigError
        If the rig does not start.

    Examples
    --------
    >>> from simulator import open_rig_seeing, render, scene_named
    >>> view = render(scene_named("coin", width=64, height=52, leds=4))
    >>> with open_rig_seeing(view, realtime=False, camera="inside") as rig:
    ...     shot = rig.shoot(2, exposure_us=10_000.0)
    >>> shot.led, shot.frame.pixels.shape
    (2, (52, 64))
    """
    leds = len(rendering.scene.lights)
    if config is None:
        config = RigConfig(name="simulated", driver="simulated", leds=leds)
    if config.leds != leds:
        raise RigConfigError(f"rig {config.name} has {config.leds} LEDs, its scene has {leds}")
    scene = rendering.scene
    if not config.led_positions_mm and scene.lights.positions_mm is not None:
        positions_mm = tuple((x, y, z) for x, y, z in scene.lights.positions_mm.tolist())
        config = config.model_copy(update={"led_positions_mm": positions_mm})
    lamps, wiring = flaws.lamps or scene.lamps, flaws.wiring
    for fault, listed in (("dead", lamps.dead), ("wrongly wired", wiring.leds)):
        if any(led >= leds for led in listed):
            raise RigConfigError(
                f"rig {config.name}: {fault} LEDs {list(listed)} must be within 0..{leds - 1}"
            )
    return simulated_rig(
        rendering.plane,
        config,
        size=scene.lens.size,
        formation=ImageFormation(
            noise=scene.noise,
            seed=seed,
            noisy=noisy,
            cfa=scene.lens.cfa,
            lamps=lamps,
            shake_px=flaws.shake_px,
            sensor_seed=sensor_seed,
        ),
        realtime=realtime,
        camera=camera,
        frame_rate_hz=frame_rate_hz,
        wiring=wiring,
    )
