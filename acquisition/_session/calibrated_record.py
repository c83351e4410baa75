"""When and with what lights were calibrated, as the key ``calibrated`` of stored lights."""

from __future__ import annotations

import json
from typing import Annotated

from pydantic import AwareDatetime, Field

from acquisition._session.value_records import CameraModelRecord, Table
from acquisition._values.setup import Calibrated, Setup, UsedSphere

_Positive = Annotated[float, Field(gt=0)]


class _Camera(Table):
    vendor: str = ""
    model: str = ""
    serial: str = ""


class _Sphere(Table):
    centre_px: tuple[float, float]
    radius_px: _Positive
    centre_mm: tuple[float, float, float] | None = None
    radius_mm: _Positive | None = None
    recording: str = ""


class CalibratedRecord(Table):
    """Fields of `Calibrated` and its `Setup`; what is not known is absent."""

    time_utc: AwareDatetime | None = None
    rig: str = ""
    camera: _Camera | None = None
    intrinsics: CameraModelRecord | None = None
    spheres: tuple[_Sphere, ...] = ()

    @classmethod
    def of(cls, calibrated: Calibrated) -> CalibratedRecord:
        """Return the record of a value."""
        setup = calibrated.setup
        names = {
            "vendor": setup.camera_vendor,
            "model": setup.camera_model,
            "serial": setup.camera_serial,
        }
        known = {name: text for name, text in names.items() if text}
        return cls(
            time_utc=calibrated.time_utc,
            rig=setup.rig,
            camera=_Camera(**known) if known else None,
            intrinsics=None if setup.intrinsics is None else CameraModelRecord.of(setup.intrinsics),
            spheres=tuple(
                _Sphere(
                    centre_px=sphere.centre_px,
                    radius_px=sphere.radius_px,
                    centre_mm=sphere.centre_mm,
                    radius_mm=sphere.radius_mm,
                    recording=sphere.recording,
                )
                for sphere in calibrated.spheres
            ),
        )

    def value(self) -> Calibrated:
        """Return the value; raise DataError if it is invalid."""
        camera = self.camera or _Camera()
        return Calibrated(
            self.time_utc,
            Setup(
                self.rig,
                camera.vendor,
                camera.model,
                camera.serial,
                None if self.intrinsics is None else self.intrinsics.value(),
            ),
            tuple(
                UsedSphere(
                    sphere.centre_px,
                    sphere.radius_px,
                    sphere.centre_mm,
                    sphere.radius_mm,
                    sphere.recording,
                )
                for sphere in self.spheres
            ),
        )

    def json_text(self) -> str:
        """Return the record as JSON in one line, without what is not known."""
        return json.dumps(self.model_dump(mode="json", exclude_none=True, exclude_defaults=True))
