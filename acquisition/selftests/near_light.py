"""Fit of the brightness of a matte scene under each LED of a dome to the camera's images.

Every place of the scene has an unknown product of normal and albedo, m. Its brightness under an LED
is m . s, where s is the vector of the arriving light; the LED's position determines s except for
the unknown width of the field of view. There are three unknowns per place but as many images as
LEDs, so the images show whether they match the positions. Shadows, highlights and LEDs in another
place than stated are outliers and get little weight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rig.arrays import Float64, Intp

_WIDTHS = 14  # number of widths tried for the field of view
_ROUNDS = 8
_TINY = 1e-6


def known_mean(values: Float64, axis: int) -> Float64:
    """Return the mean of the known values, 0 without known values."""
    known = np.isfinite(values)
    total: Float64 = np.where(known, values, 0).sum(axis=axis) / np.maximum(known.sum(axis=axis), 1)
    return total


@dataclass(frozen=True, eq=False)
class Images:
    """Coarse images of one scene, one per LED.

    Parameters
    ----------
    light
        ``(N, B)`` grey values minus those of the dark frame, NaN where not known.
    places
        ``(B, 2)`` x to the right and y up in widths of the image, from its centre.
    """

    light: Float64
    places: Float64

    @property
    def ratios(self) -> Float64:
        """The images divided by their mean, so that the albedo cancels; NaN where not known."""
        ratios: Float64 = self.light / self.mean
        return ratios

    @property
    def mean(self) -> Float64:
        """``(B,)`` mean of the known values over the LEDs; NaN without known values or if 0."""
        mean = known_mean(self.light, axis=0)
        return np.where(mean > 0, mean, np.nan)


@dataclass(frozen=True, eq=False)
class Fit:
    """A scene fitted to the images.

    Parameters
    ----------
    rows
        ``(N,)`` indices of the positions to which the images belong.
    ratios
        ``(N, B)`` the images, as `Images.ratios`.
    predicted
        ``(M, B)`` predicted ratios under an LED at each position.
    misfit
        ``(N, M)`` median difference between an image and the scaled prediction for each position,
        relative to the image.
    scale
        ``(N, M)`` scale factors: measured brightness relative to the prediction.
    """

    rows: Intp
    ratios: Float64
    predicted: Float64
    misfit: Float64
    scale: Float64


def fit(images: Images, positions: Float64, rows: Intp) -> Fit:
    """Fit scene and field of view to images of at least four LEDs at known positions.

    Parameters
    ----------
    images
        ``N`` images.
    positions
        ``(M, 3)`` positions of these and other LEDs.
    rows
        ``(N,)`` index of the position of each image.
    """
    ratios, own = images.ratios, positions[rows]
    farthest = float(np.linalg.norm(positions, axis=1).max())
    scenes = (
        _scene(ratios, own, np.pad(images.places * width, [(0, 0), (0, 1)]))
        for width in np.geomspace(0.03 * farthest, 2 * farthest, _WIDTHS)
    )
    scene = min(scenes, key=lambda fitted: _own_misfit(ratios, fitted.under(own)))
    predicted = scene.under(positions)
    return Fit(rows, ratios, predicted, *misfits(ratios, predicted))


def misfits(ratios: Float64, predicted: Float64) -> tuple[Float64, Float64]:
    """Return misfit and scale, as in `Fit`, of ``(K, B)`` images and ``(N, B)`` predictions."""
    known = np.isfinite(ratios)
    misfit = np.zeros((len(ratios), len(predicted)))
    scale = np.zeros_like(misfit)
    for index, (row, valid) in enumerate(zip(ratios, known, strict=True)):
        seen, basis = row[valid], predicted[:, valid]
        factors = (basis @ seen) / np.maximum((basis**2).sum(axis=1), _TINY)
        for _ in range(4):
            weights = _weights(seen - factors[:, None] * basis)
            norm = np.maximum((weights * basis**2).sum(axis=1), _TINY)
            factors = (weights * basis * seen).sum(axis=1) / norm
        rest = np.abs(seen - factors[:, None] * basis)
        misfit[index] = np.median(rest, axis=1) / max(float(np.median(seen)), _TINY)
        scale[index] = factors
    return misfit, scale


def mixtures(ratio: Float64, predicted: Float64, own: int) -> tuple[Float64, Float64]:
    """Explain one image as the light of LED ``own`` together with each of the others in turn.

    Returns
    -------
    misfit
        ``(N,)`` as in `Fit`; infinite for ``own`` itself.
    shares
        ``(N, 2)`` shares of LED ``own`` and of the other LED, at least 0.
    """
    valid = np.isfinite(ratio)
    seen, others = ratio[valid], predicted[:, valid]
    basis = np.stack([np.broadcast_to(others[own], others.shape), others], axis=1)
    weights = np.ones_like(others)
    for _ in range(4):
        weighted = basis * weights[:, None]
        normal = weighted @ basis.transpose(0, 2, 1) + _TINY * np.eye(2)
        right = weighted @ seen
        shares = np.linalg.solve(normal, right[..., None])[..., 0]
        # If the share of one LED would be negative, use the other LED alone.
        alone = np.maximum(right, 0) / np.diagonal(normal, axis1=1, axis2=2)
        shares = np.where(shares[:, ::-1] < 0, alone, shares) * (shares >= 0)
        rest = seen - (shares[:, None] @ basis)[:, 0]
        weights = _weights(rest)
    misfit = np.median(np.abs(rest), axis=1) / max(float(np.median(seen)), _TINY)
    misfit[own] = np.inf
    return misfit, shares


@dataclass(frozen=True, eq=False)
class _Scene:
    """The surface under the camera.

    Parameters
    ----------
    surface
        ``(B, 3)`` normal times albedo of every place, divided by the images' mean.
    points
        ``(B, 3)`` positions of the places, in the unit of the LED positions.
    """

    surface: Float64
    points: Float64

    def under(self, positions: Float64) -> Float64:
        """Return ``(N, B)`` predicted `Images.ratios` under LEDs at these positions."""
        return _shaded(self.surface, _arriving(positions, self.points))


def _own_misfit(ratios: Float64, predicted: Float64) -> float:
    """Return the median misfit of the LEDs at their own positions."""
    known = np.isfinite(ratios)
    seen = np.where(known, ratios, 0.0)
    power = np.maximum((known * predicted**2).sum(axis=1), _TINY)
    scale = (seen * predicted).sum(axis=1) / power
    rest = np.where(known, np.abs(seen - scale[:, None] * predicted), np.nan)
    return float(np.median(np.nanmedian(rest, axis=1)))


def _shaded(surface: Float64, arriving: Float64) -> Float64:
    shaded: Float64 = np.clip(np.einsum("kbi,bi->kb", arriving, surface), 0, None)
    return shaded


def _arriving(positions: Float64, points: Float64) -> Float64:
    """Return ``(N, B, 3)`` light vectors on the plane z = 0 of LEDs that point to the origin."""
    toward = positions[:, None] - points
    distance = np.linalg.norm(toward, axis=2, keepdims=True)
    aim = positions / np.linalg.norm(positions, axis=1, keepdims=True)
    lobe = np.clip((toward * aim[:, None]).sum(axis=2, keepdims=True) / distance, 0, None)
    arriving: Float64 = toward * lobe / distance**3
    scale = float(np.mean(np.linalg.norm(positions, axis=1)))
    return arriving * scale**2


def _scene(ratios: Float64, positions: Float64, points: Float64) -> _Scene:
    """Fit normal times albedo of every place by reweighted least squares."""
    arriving = _arriving(positions, points)
    count = len(ratios)
    known = np.isfinite(ratios)
    seen = np.where(known, ratios, 0.0)
    # Places without known values get the weight 0.
    weights, brightness, trust = known.astype(float), np.ones(count), np.ones(count)
    surface: Float64 = np.zeros((ratios.shape[1], 3))
    ridge = 1e-9 * count * np.eye(3)
    for _ in range(_ROUNDS):
        trusted = (weights * trust[:, None])[..., None] * arriving
        normal = trusted.transpose(1, 2, 0) @ arriving.transpose(1, 0, 2) + ridge
        right = np.einsum("kbi,kb->bi", trusted, seen / brightness[:, None])
        surface = np.linalg.solve(normal, right[..., None])[..., 0]
        predicted = _shaded(surface, arriving)
        rest = np.where(known, np.abs(seen / brightness[:, None] - predicted), np.nan)
        spread = 1.4826 * np.nanmedian(rest) + _TINY
        weights = np.where(known, 1 / np.maximum(1, rest / (1.5 * spread)), 0.0)
        # An LED in another place is wrong in all places of its image.
        each = np.nanmedian(rest, axis=1)
        trust = 1 / np.maximum(1, (each / (2 * np.median(each) + _TINY)) ** 4)
        power = np.maximum((weights * predicted**2).sum(axis=1), _TINY)
        brightness = np.clip((weights * seen * predicted).sum(axis=1) / power, 0.2, 5.0)
        brightness /= np.median(brightness)
    return _Scene(surface, points)


def _weights(rest: Float64) -> Float64:
    """Return the Huber weights of each row of residuals."""
    size = np.abs(rest)
    spread = np.median(size, axis=1, keepdims=True) + _TINY
    weights: Float64 = 1 / np.maximum(1, size / (2 * spread))
    return weights
