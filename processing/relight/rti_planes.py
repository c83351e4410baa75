"""Relightable images as RelightLab and OpenLIME read them: JPEG planes and info.json.

Each plane is a JPEG whose three channels are three coefficients of 8 bits; ``(sample / 255 - bias)
* scale`` is a coefficient. ``lrgb``: the first plane is the colour, and the next ones have the
coefficients in turn. ``rgb``: each plane has one coefficient of the three colours. The first row is
the highest one.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from acquisition import DataError, Identity, StorageError, write_durably
from processing.relight.relightable_image import RelightableImage
from rig import check_type
from rig.arrays import Float32, Float64, UInt8

# Coefficients of few pixels, for example of those with few samples, may be far from all others: at
# most this share is clipped at either end.
_CLIPPED = 1e-4
_MOST = 2_000_000
# Largest side of a JPEG that decoders accept.
_LONGEST = 65_500
_NAMES = {"ptm": "ptm", "hsh4": "hsh", "hsh9": "hsh"}


class _Coded(NamedTuple):
    """Coefficients ``(samples - bias) * scale``.

    Parameters
    ----------
    samples
        ``(H, W, K)`` uint8.
    scale
        ``(K,)`` positive.
    bias
        ``(K,)`` whole numbers, 0 to 255.
    """

    samples: UInt8
    scale: Float64
    bias: Float64

    def decoded(self) -> Float32:
        """Return the coefficients that the samples stand for."""
        return ((self.samples.astype(np.float32) - self.bias) * self.scale).astype(np.float32)


def _coded(coefficients: Float32) -> _Coded:
    """Round coefficients ``(H, W, K)`` to 8 bits; 0 is always among the values of the samples."""
    terms = coefficients.shape[2]
    flat = coefficients.reshape(-1, terms)
    some = flat[:: 1 + len(flat) // _MOST]
    low = np.minimum(np.quantile(some, _CLIPPED, axis=0, method="lower"), 0).astype(np.float64)
    high = np.maximum(np.quantile(some, 1 - _CLIPPED, axis=0, method="higher"), 0)
    scale = (high - low) / 254
    scale[scale == 0] = 1.0
    # The written text of the scale is what readers multiply by.
    scale = np.array([float(f"{step:.9g}") for step in scale])
    bias = np.ceil(np.abs(low) / scale)
    samples = np.zeros(coefficients.shape, np.uint8)
    for row, line in enumerate(coefficients):
        samples[row] = np.clip(np.rint(line / scale + bias), 0, 255)
    return _Coded(samples, scale, bias)


def write_rti_planes(
    folder: str | Path,
    image: RelightableImage,
    directions: npt.ArrayLike,
    *,
    quality: int = 95,
    recordings: Iterable[Identity] = (),
) -> tuple[list[Path], RelightableImage]:
    """Write a relightable image as planes for web viewers: ``plane_0.jpg`` ... and ``info.json``.

    Parameters
    ----------
    folder
        Existing folder; files of these names are replaced.
    image
        The image.
    directions
        ``(N, 3)`` directions of the lights of the images, which info.json lists.
    quality
        Quality of the JPEGs, 1 to 100. Chroma is not subsampled, because the channels are
        unrelated.
    recordings
        What the images are of, which info.json lists for people.

    Returns
    -------
    files : list of Path
        The files; info.json is the last.
    stored : RelightableImage
        The image as viewers decode it.

    Raises
    ------
    DataError
        If the quality is out of range or the image is too large for a JPEG.
    StorageError
        If a file cannot be written.

    Examples
    --------
    >>> import json
    >>> import numpy as np
    >>> from pathlib import Path
    >>> from processing import NormalMap
    >>> from processing.relight import fit_normals, write_rti_planes
    >>> facing = NormalMap.from_vectors(np.tile([0.0, 0.0, 1.0], (4, 5, 1)))
    >>> image = fit_normals(facing, np.ones((4, 5)), basis="hsh9").image
    >>> files, stored = write_rti_planes(".", image, [[0, 0, 1]])
    >>> [path.name for path in files][::4], stored.relit([0, 0, 1])[0, 0].round(1)
    (['plane_0.jpg', 'info.json'], array([1., 1., 1.], dtype=float32))
    """
    check_type("image", image, RelightableImage, "fit_recording(source).image is one")
    height, width = image.size
    if not 1 <= quality <= 100:
        raise DataError(f"the quality of a JPEG is 1 to 100, not {quality}")
    if max(height, width) > _LONGEST:
        raise DataError(f"{width} x {height} pixels: a JPEG has at most {_LONGEST} on each side")
    lights = np.asarray(directions, np.float64).reshape(-1, 3)
    lights = lights / np.linalg.norm(lights, axis=1, keepdims=True)
    planes = _planes(image)
    scales, biases, written, stored = [], [], [], []
    for number in range(planes.shape[2] // 3):
        encoded = _coded(planes[:, :, 3 * number : 3 * number + 3])
        scales += [float(step) * 255 for step in encoded.scale]
        biases += [float(bias) / 255 for bias in encoded.bias]
        written.append(Path(folder) / f"plane_{number}.jpg")
        data = _jpeg(encoded.samples, quality, written[-1])
        write_durably(written[-1], data)
        seen = np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR_RGB))
        stored.append(encoded._replace(samples=seen.astype(np.uint8)).decoded())
    info: dict[str, Any] = {
        "width": width,
        "height": height,
        "format": "jpg",
        "type": _NAMES[image.basis],
        "colorspace": "rgb" if image.colour is None else "lrgb",
        "lights": [round(float(x), 6) for x in lights.ravel()],
        "nplanes": planes.shape[2],
        "quality": quality,
        "materials": [{"scale": scales, "bias": biases}],
    }
    # Viewers ignore keys that they do not know.
    if listed := [asdict(identity) for identity in recordings]:
        info["recordings"] = listed
    written.append(Path(folder) / "info.json")
    write_durably(written[-1], f"{json.dumps(info, indent=1)}\n".encode())
    return written, _image(np.concatenate(stored, axis=2), image)


def _planes(image: RelightableImage) -> Float32:
    """Return all coefficients ``(H, W, 3 M)`` in the order of the planes."""
    height, width = image.size
    if image.colour is None:
        return image.coefficients.reshape(height, width, -1)
    terms = image.coefficients.shape[2]
    # The last plane is filled up with terms that are 0.
    empty = np.zeros((height, width, -terms % 3), np.float32)
    return np.concatenate([np.clip(image.colour, 0, 1), image.coefficients, empty], axis=2)


def _image(planes: Float32, like: RelightableImage) -> RelightableImage:
    if like.colour is None:
        return RelightableImage(like.basis, planes.reshape(like.coefficients.shape))
    terms = like.coefficients.shape[2]
    return RelightableImage(like.basis, planes[..., 3 : 3 + terms], planes[..., :3])


def _jpeg(samples: UInt8, quality: int, path: Path) -> bytes:
    options = [
        cv2.IMWRITE_JPEG_QUALITY,
        quality,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
    ]
    done, data = cv2.imencode(".jpg", np.ascontiguousarray(samples[..., ::-1]), options)
    if not done:
        raise StorageError(f"{path}: cannot be encoded: free memory on this computer")
    return data.tobytes()
