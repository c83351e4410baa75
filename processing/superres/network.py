"""Networks for super-resolution, run by OpenCV."""

from __future__ import annotations

import cv2
import numpy as np

from acquisition import DataError
from processing.superres.model import SuperResolutionModel
from processing.superres.network_trial import try_network
from rig.arrays import Float32

_CHANNELS = 5
_PROBE_PX = (12, 16)
_SYMMETRIES = 8


class Network:
    """A loaded network.

    Its input is ``(1, 3, h, w)``, the unit vectors of the low resolution; its output is
    ``(1, 5, s h, s w)``: what it adds to their bicubic interpolation, and the natural logarithms of
    the mean-square errors of its result and of bicubic interpolation, in radians squared.

    Parameters
    ----------
    model
        The file. One of another origin is tried in a separate process first.
    tried
        Whether this was done.

    Raises
    ------
    DataError
        If OpenCV cannot load it, or its output has another shape.
    """

    def __init__(self, model: SuperResolutionModel, *, tried: bool = False) -> None:
        if not tried:
            try_network(model)
        self._model = model
        self.deviations = model.deviations
        try:
            self._net = cv2.dnn.readNetFromONNX(np.frombuffer(model.data, np.uint8))
        except cv2.error as error:
            raise self._error("OpenCV cannot load it") from error
        probe = np.zeros((*_PROBE_PX, 3), np.float32)
        probe[..., 2] = 1
        self.run(probe)

    def run(self, low: Float32) -> Float32:
        """Return ``(s h, s w, 5)`` float32 for ``(h, w, 3)`` vectors.

        Raises
        ------
        DataError
            If the network cannot process it, or a value of the output is not finite.
        """
        blob = np.ascontiguousarray(low.transpose(2, 0, 1)[None])
        try:
            self._net.setInput(blob)
            high = np.asarray(self._net.forward())
        except cv2.error as error:
            raise self._error("OpenCV cannot run it") from error
        scale = self._model.scale
        shape = (1, _CHANNELS, scale * low.shape[0], scale * low.shape[1])
        if high.shape != shape or high.dtype != np.float32:
            raise self._error(
                f"its output is {high.dtype} of shape {high.shape} for an input of {blob.shape}, "
                f"not float32 of shape {shape}"
            )
        if not np.isfinite(high).all():
            raise self._error("its output is not finite")
        return np.asarray(high[0].transpose(1, 2, 0), np.float32)

    def run_turned(self, low: Float32) -> Float32:
        """Run all mirrored and turned copies and return their mean, as `run` does.

        The mean-square errors are means, too, which is a limit: that of a mean result is smaller by
        the variance between the copies. This variance is not subtracted, because errors that the
        network predicts too small would become much too small.
        """
        copies = (_turned_back(self.run(turned(low, k)), k) for k in range(_SYMMETRIES))
        total = sum(np.dstack([c[..., :3], np.exp(c[..., 3:])]) for c in copies)
        mean = np.asarray(total, np.float32) / _SYMMETRIES
        return np.dstack([mean[..., :3], np.log(mean[..., 3:])])

    def _error(self, reason: str) -> DataError:
        return DataError(
            f"{self._model.path}: not a network for super-resolution of scale {self._model.scale}: "
            f"{reason}"
        )


def turned(vectors: Float32, symmetry: int) -> Float32:
    """Return one of the 8 mirrored or turned copies of an image, whose x and y follow.

    Parameters
    ----------
    vectors
        ``(H, W, C)``; the first two channels are the x (right) and y (up) of vectors.
    symmetry
        0 to 7: a fourth turn counter-clockwise as often as the last two bits say, then mirrored
        left to right if the first bit is set.
    """
    turns, mirrored = symmetry & 3, symmetry & 4
    image = np.rot90(vectors, turns).copy()
    x, y = image[..., 0], image[..., 1]
    image[..., :2] = np.stack(((x, y), (-y, x), (-x, -y), (y, -x))[turns], axis=-1)
    if mirrored:
        image = image[:, ::-1].copy()
        image[..., 0] *= -1
    return image


def _turned_back(image: Float32, symmetry: int) -> Float32:
    turns, mirrored = symmetry & 3, symmetry & 4
    if mirrored:
        image = image[:, ::-1].copy()
        image[..., 0] *= -1
    return turned(image, -turns & 3)
