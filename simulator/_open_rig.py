"""Rigs that look at rendered scenes."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from acquisition import DataError
from rig import Rig, RigConfig, RigConfigError, first_complaint
from simulator._render import Rendering, render
from simulator._rig_scenes import SCENES, scene_named
from simulator._simulated_rig import simulated_rig

_Pixels = Annotated[int, Field(ge=1, le=16384)]


class RigOptions(BaseModel):
    """The ``options`` of a rig file whose driver is ``simulated``.

    Parameters
    ----------
    scene
        What lies under the camera, a name of ``SCENES``.
    width, height
        Image size in pixels.
    seed
        Of lights, texture, paint and noise.
    noise
        False leaves shot and read noise out.
    realtime
        False does not wait for exposures to pass.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    scene: str = SCENES[0]
    width: _Pixels = 640
    height: _Pixels = 512
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    noise: bool = True
    realtime: bool = True


def open_rig(config: RigConfig) -> Rig:
    """Render a scene and open the simulated rig on it: the driver ``simulated``.

    Parameters
    ----------
    config
        LED count and, as ``options``, what `RigOptions` lists.

    Returns
    -------
    Rig
        Open; closing it ends the virtual board's process.

    Raises
    ------
    RigConfigError
        If an option is not understood or the scene cannot be.
    RigError
        If the rig does not come up.
    """
    try:
        options = RigOptions.model_validate(config.options)
    except ValidationError as error:
        complaint = first_complaint(error, noun="option", known=RigOptions.model_fields)
        raise RigConfigError(f"rig {config.name}: {complaint}") from error
    try:
        scene = scene_named(
            options.scene,
            width=options.width,
            height=options.height,
            leds=config.leds,
            seed=options.seed,
        )
        rendering = render(scene)
    except DataError as error:
        raise RigConfigError(f"rig {config.name}: {error}") from error
    return rig_for(
        rendering,
        config,
        seed=options.seed,
        noisy=options.noise,
        realtime=options.realtime,
    )


def rig_for(
    rendering: Rendering,
    config: RigConfig | None = None,
    *,
    seed: int = 0,
    noisy: bool = True,
    realtime: bool = True,
) -> Rig:
    """Open a simulated rig on what has been rendered, so that its truth is at hand.

    Parameters
    ----------
    rendering
        What the camera sees.
    config
        Its LED count must be the rendering's. By default a rig called ``simulated``.
    seed
        Of the noise.
    noisy
        False leaves shot and read noise out.
    realtime
        False does not wait for exposures to pass.

    Returns
    -------
    Rig
        Open; closing it ends the virtual board's process.

    Raises
    ------
    RigConfigError
        If the LED counts differ.
    RigError
        If the rig does not come up.
    """
    leds = len(rendering.planes)
    if config is None:
        config = RigConfig(name="simulated", driver="simulated", leds=leds)
    if config.leds != leds:
        raise RigConfigError(f"rig {config.name} has {config.leds} LEDs, its scene {leds}")
    return simulated_rig(
        rendering.plane,
        config,
        size=rendering.truth.camera.size,
        noise=rendering.truth.noise,
        seed=seed,
        noisy=noisy,
        realtime=realtime,
    )
