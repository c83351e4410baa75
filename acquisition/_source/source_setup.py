"""Rig, camera and lens of a source, and whether its lights belong to them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from acquisition._source.source import Source
from acquisition._values.camera_model import CameraModel
from acquisition._values.setup import Setup
from rig import Notice, check_type

# A focal length wrong by 1 % moves lights by about a hundredth of their distance; two calibrations
# of one camera agree better than this.
_SAME = 0.005


def source_setup(source: Source) -> Setup:
    """Return rig, camera and lens of a recording; the lens is that of its complete images.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import CameraModel, crop, read_source, source_setup, write_png
    >>> write_png("card.png", np.full((40, 50), 700, np.uint16))
    >>> camera = CameraModel([[90, 0, 25], [0, 90, 20], [0, 0, 1]], 50, 40)
    >>> part = crop(read_source("card.png", camera=camera), 10, 10, 20, 20)
    >>> source_setup(part).intrinsics
    CameraModel(50 x 40 px, focal length 90.0 px)
    """
    check_type("source", source, Source, "read_source(path) returns one")
    return replace(source.setup, intrinsics=_complete(source))


def setup_notices(source: Source) -> tuple[Notice, ...]:
    """Return warnings if the lights of a source were calibrated with another rig or camera.

    What one of them does not state is not compared. Images of another size are the same camera if
    they show the same field of view.

    Parameters
    ----------
    source
        Recording with lights.

    Returns
    -------
    tuple[Notice, ...]
        ``lights-of-another-rig`` and ``lights-of-another-camera``, each at most once.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import Calibrated, CameraModel, Lights, Setup, read_source, write_png
    >>> from acquisition import setup_notices
    >>> write_png("card.png", np.full((40, 50), 700, np.uint16))
    >>> old, new = (CameraModel([[f, 0, 25], [0, f, 20], [0, 0, 1]], 50, 40) for f in (90, 95))
    >>> lights = Lights([[0, 0, 1]], calibrated=Calibrated(setup=Setup(intrinsics=old)))
    >>> source = read_source("card.png", lights=lights, camera=new)
    >>> [notice.code for notice in setup_notices(source)]
    ['lights-of-another-camera']
    """
    check_type("source", source, Source, "read_source(path) returns one")
    if source.lights is None or source.lights.calibrated is None:
        return ()
    then, now, where = source.lights.calibrated.setup, source_setup(source), str(source.path)
    notices = []
    if then.rig and now.rig and then.rig != now.rig:
        text = (
            f"the lights were calibrated on the rig {then.rig}, the images were recorded on "
            f"{now.rig}: give the lights of this rig"
        )
        notices.append(Notice("lights-of-another-rig", text, where))
    differences = setup_differences(replace(then, rig=""), now)
    if differences:
        text = (
            f"the lights were calibrated with another camera or lens: {', '.join(differences)}; "
            "calibrate with the camera of these images"
        )
        notices.append(Notice("lights-of-another-camera", text, where))
    return tuple(notices)


def setup_differences(then: Setup, now: Setup, share: float = _SAME) -> tuple[str, ...]:
    """Return what differs between the rigs, cameras and lenses of two setups, each in a few words.

    What one of them does not state is not compared. Images of another size are the same camera if
    they show the same field of view.

    Parameters
    ----------
    then, now
        Setups of a calibration and of a recording, or of two recordings.
    share
        Lenses differ if rays at the same places differ by more than this share of half the field
        of view, or working distances by more than this share.

    Examples
    --------
    >>> from acquisition import Setup, setup_differences
    >>> setup_differences(Setup(rig="dome", camera_model="M2"), Setup(rig="arc"))
    ('rig dome, now arc',)
    """
    names = (
        ("rig", then.rig, now.rig),
        ("model", then.camera_model, now.camera_model),
        ("serial number", then.camera_serial, now.camera_serial),
    )
    differences = [f"{name} {a}, now {b}" for name, a, b in names if a and b and a != b]
    return (*differences, *_lens_differences(then, now, share))


def lens_notices(source: Source, camera: CameraModel) -> tuple[Notice, ...]:
    """Return a warning if a camera was calibrated with another lens or focus than a recording.

    What one of them does not state is not compared.

    Parameters
    ----------
    source
        Recording, with the camera that it states.
    camera
        Camera that is used instead.

    Returns
    -------
    tuple[Notice, ...]
        ``camera-of-another-lens``, at most once.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import CameraModel, lens_notices, read_source, write_png
    >>> write_png("card.png", np.full((40, 50), 700, np.uint16))
    >>> K = [[90, 0, 25], [0, 90, 20], [0, 0, 1]]
    >>> recorded = read_source("card.png", camera=CameraModel(K, 50, 40, lens="16 mm"))
    >>> [notice.code for notice in lens_notices(recorded, CameraModel(K, 50, 40, lens="25 mm"))]
    ['camera-of-another-lens']
    """
    check_type("source", source, Source, "read_source(path) returns one")
    differences = [] if source.camera is None else _named_differences(camera, source.camera)
    if not differences:
        return ()
    text = (
        f"the camera was calibrated with another lens or focus: {', '.join(differences)}; "
        "calibrate with the lens of these images"
    )
    return (Notice("camera-of-another-lens", text, str(source.path)),)


def _named_differences(a: CameraModel, b: CameraModel) -> list[str]:
    """Return what differs between the stated lenses and their focus."""
    differences = []
    if a.lens and b.lens and a.lens != b.lens:
        differences.append(f"lens {a.lens}, now {b.lens}")
    if (
        a.focus_mm is not None
        and b.focus_mm is not None
        and abs(a.focus_mm / b.focus_mm - 1) > _SAME
    ):
        differences.append(f"focus at {a.focus_mm:g} mm, now {b.focus_mm:g} mm")
    return differences


def _complete(source: Source) -> CameraModel | None:
    """Return the camera of the complete images, from which a region may have been taken."""
    camera, part = source.camera, source.reduction
    if camera is None or part is None:
        return camera
    K = camera.K.copy()
    K[:2] *= part.factor
    K[:2, 2] += (part.factor - 1) / 2 + np.array([part.x, part.y])
    height, width = source.frames[0].shape[:2]
    return replace(camera, K=K, width=width, height=height)


def _lens_differences(then: Setup, now: Setup, limit: float) -> list[str]:
    a, b = then.intrinsics, now.intrinsics
    if a is None or b is None:
        return []
    differences = _named_differences(a, b)
    share = _field_difference(a, b)
    if share > limit:
        what = (
            f"focal length {_focal(a)}, now {_focal(b)}"
            if abs(a.focal_px / a.width / (b.focal_px / b.width) - 1) > limit
            else f"rays that differ by {share:.1%} of the field of view"
        )
        differences.append(what)
    first, second = a.working_distance_mm, b.working_distance_mm
    if first is not None and second is not None and abs(first / second - 1) > limit:
        differences.append(f"working distance {first:g} mm, now {second:g} mm")
    return differences


def _focal(camera: CameraModel) -> str:
    return f"{camera.focal_px:.0f} px at {camera.width} x {camera.height}"


def _field_difference(a: CameraModel, b: CameraModel) -> float:
    """Return the largest difference of rays at the same places, relative to half the field."""
    share = np.linspace(0, 1, 5)
    places = np.stack(np.meshgrid(share, share), axis=-1).reshape(-1, 2)
    first, second = (
        camera.rays(places * (camera.width, camera.height) - 0.5)[:, :2] for camera in (a, b)
    )
    field = np.linalg.norm(first - first.mean(axis=0), axis=1).max()
    return float(np.linalg.norm(first - second, axis=1).max() / field)
