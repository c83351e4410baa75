"""Networks for super-resolution as files: an ONNX network, and a JSON file that describes it."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from acquisition import DataError, MissingPathError
from rig import UnreadableError, read_bounded
from rig.arrays import Float32
from rig.files import check_text
from rig.messages import validation_message

Domain = Literal["detail", "normals"]
Scale = Literal[2, 4]
_Count = Annotated[int, Field(gt=0, le=4096)]

_LEAST = 1e-16  # radian^2
SCALES = (2, 4)
_SAID = {"detail": "detail components", "normals": "normals"}
_SHIPPED = Path(__file__).with_name("models")
# The network of the paper's size has 90 MB.
_MOST_BYTES = 1 << 28


@dataclass(frozen=True)
class Deviations:
    """Actual deviations for predicted ones, measured on surfaces that were not trained on.

    A network extrapolates the logarithm of its mean-square error, which has no limits. The
    correction is linear in logarithms between the given values, has the last one as its limit, and
    the ratio of the first ones below them.

    Parameters
    ----------
    predicted_deg
        Predicted standard deviations in degrees, increasing, two or more.
    actual_deg
        Root mean square errors of pixels with these predictions, in degrees; none is smaller than
        the one before.

    Raises
    ------
    ValueError
        If they are not such values.

    Examples
    --------
    >>> from processing.superres import Deviations
    >>> Deviations((0.1, 1, 10), (0.2, 1, 5)).corrected_deg([0.05, 1, 40]).round(3)
    array([0.1, 1. , 5. ], dtype=float32)
    """

    predicted_deg: tuple[float, ...]
    actual_deg: tuple[float, ...]

    def __post_init__(self) -> None:
        predicted, actual = (np.array(one) for one in (self.predicted_deg, self.actual_deg))
        good = len(predicted) == len(actual) > 1 and min(predicted[0], actual[0]) > 0
        if not (good and (np.diff(predicted) > 0).all() and (np.diff(actual) >= 0).all()):
            raise ValueError(
                "the predicted and actual deviations are not two rows of as many positive values, "
                "the predicted ones increasing and the actual ones not decreasing"
            )
        if not (np.isfinite(predicted).all() and np.isfinite(actual).all()):
            raise ValueError("a predicted or actual deviation is not finite")

    def corrected_deg(self, predicted_deg: npt.ArrayLike) -> Float32:
        """Return actual deviations in degrees for predicted ones."""
        variance = np.radians(np.asarray(predicted_deg, np.float32)) ** 2
        return np.asarray(np.degrees(np.sqrt(self.corrected(variance))), np.float32)

    def corrected(self, variance: Float32) -> Float32:
        """Return actual for predicted mean-square errors, in radians squared."""
        known, actual = (
            2 * np.log(np.radians(one)) for one in (self.predicted_deg, self.actual_deg)
        )
        logs = np.log(np.maximum(variance, _LEAST))
        below = np.minimum(logs - known[0], 0)
        return np.asarray(np.exp(np.interp(logs, known, actual) + below), np.float32)


class _Sidecar(BaseModel):
    """The description next to a network."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    format: Literal[1]
    name: Annotated[str, Field(min_length=1, max_length=100)]
    scale: Scale
    domain: Domain
    architecture: Literal["rdn"]
    blocks: _Count
    convolutions: _Count
    growth: _Count
    halo_px: _Count
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    deviations: Deviations | None = None
    training: dict[str, Any]


@dataclass(frozen=True, repr=False)
class SuperResolutionModel:
    """A network whose bytes agree with its description.

    Parameters
    ----------
    path
        The ONNX file.
    name
        Name of the model.
    scale
        Factor of the resolution, 2 or 4.
    domain
        Whether the network was trained on detail components or on normals.
    halo_px
        How far a result depends on its surroundings, in pixels of the low resolution.
    sha256
        Hash of the file.
    training
        How the network was trained: seed, steps, data, software.
    data
        The bytes of the file.
    deviations
        Actual deviations for predicted ones; None if they were not measured.
    """

    path: Path
    name: str
    scale: int
    domain: Domain
    halo_px: int
    sha256: str
    training: dict[str, Any]
    data: bytes
    deviations: Deviations | None = None

    def __repr__(self) -> str:
        return f"SuperResolutionModel({self.name!r}, x{self.scale}, {self.domain})"

    def check(self, scale: int, method: str | None) -> None:
        """Refuse another scale or domain; None is any domain.

        Raises
        ------
        DataError
            The message names what the network is for.
        """
        if self.scale != scale:
            raise DataError(
                f"the network {self.name} is for scale {self.scale}, not {scale}: use that scale, "
                "or another network"
            )
        if method is not None and self.domain != method:
            raise DataError(
                f"the network {self.name} was trained on {_SAID[self.domain]}, and the method "
                f"{method} needs one that was trained on {_SAID[method]}"
            )


# What the description of a network says of it.
_DESCRIBED = ("name", "scale", "domain", "halo_px", "sha256", "training", "deviations")


def read_superres_model(
    model: str | Path | None, scale: int, method: Domain | None = None
) -> SuperResolutionModel:
    """Read a network and its description, and check that they belong together.

    Parameters
    ----------
    model
        Name of a network that comes with the program, or the path of an ``.onnx`` file that has its
        description next to it, with the suffix ``.json``. Default: the one for the scale.
    scale
        The factor that is required, 2 or 4.
    method
        The domain that is required. Default: any.

    Returns
    -------
    SuperResolutionModel
        The network, not yet loaded.

    Raises
    ------
    MissingPathError
        If a file does not exist.
    DataError
        If the scale is neither 2 nor 4, the name is unknown, a file is damaged or was altered, or
        the network is for another scale or domain.

    Examples
    --------
    >>> from processing.superres import read_superres_model
    >>> read_superres_model("superres-x4", 2)
    Traceback (most recent call last):
        ...
    acquisition.DataError: the network superres-x4 is for scale 4, not 2: ...
    """
    if scale not in SCALES:
        raise DataError(f"a scale of {scale} is not available: use 2 or 4")
    path = _path_of(model, scale, method)
    described = _description(path.with_suffix(".json"), path)
    data = _bytes(path)
    if hashlib.sha256(data).hexdigest() != described.sha256:
        raise DataError(
            f"{path}: not the network that {path.with_suffix('.json').name} describes, or altered: "
            "restore both files"
        )
    own = {name: getattr(described, name) for name in _DESCRIBED}
    made = SuperResolutionModel(path=path, data=data, **own)
    made.check(scale, method)
    return made


def comes_with_program(model: SuperResolutionModel) -> bool:
    """Return whether the bytes of a network are those of one that comes with the program."""
    return any(_description(path, path).sha256 == model.sha256 for path in _SHIPPED.glob("*.json"))


def _path_of(model: str | Path | None, scale: int, method: Domain | None) -> Path:
    if model is not None and Path(model).suffix == ".onnx":
        return Path(model)
    if model is not None:
        named = _SHIPPED / f"{model}.onnx"
        if named.is_file() and named.parent == _SHIPPED:
            return named
        names = ", ".join(sorted(path.stem for path in _SHIPPED.glob("*.onnx"))) or "none"
        raise DataError(
            f"there is no network {str(model)!r}: give a .onnx file, or one of the names {names}"
        )
    path = _SHIPPED / f"superres-x{scale}.onnx"
    if method is None or not path.is_file():
        return path
    for other in sorted(_SHIPPED.glob("*.json")):
        described = _description(other, other)
        if described.scale == scale and described.domain == method:
            return other.with_suffix(".onnx")
    raise DataError(
        f"no network for scale {scale} that was trained on {_SAID[method]} comes with the program: "
        "give the file of one"
    )


def _description(path: Path, network: Path) -> _Sidecar:
    if not path.exists() and network.exists():
        raise MissingPathError(
            f"{path}: no such file: a network needs the description that was written next to it"
        )
    text = _bytes(path if network.exists() else network)
    try:
        decoded = text.decode()
        check_text(decoded)
        return _Sidecar.model_validate_json(decoded)
    except ValidationError as error:
        reason = validation_message(error, known=_Sidecar.model_fields)
    except ValueError as error:  # also UnicodeDecodeError and UnreadableError
        reason = str(error)
    raise DataError(f"{path}: not a description of a network for super-resolution: {reason}")


def _bytes(path: Path) -> bytes:
    try:
        return read_bounded(path, _MOST_BYTES)
    except FileNotFoundError as error:
        raise MissingPathError(f"{path}: no such file") from error
    except UnreadableError as error:
        raise DataError(f"{path}: not a readable file: {error}") from error
