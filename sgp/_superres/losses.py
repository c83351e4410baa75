"""What training minimises: the angle, and the likelihood of two mean-square errors."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import torch

# Weight of the likelihood: it is small so that it hardly changes the normals.
_LIKELIHOOD = 0.02
# Added to square errors (radian^2): the rounding of normals, .02 degree.
_ROUNDING = 1e-7
# Added to squared chords, so that the derivative of the chord exists at 0.
_SMOOTHING = 1e-12


def results(low: torch.Tensor, output: torch.Tensor, scale: int) -> tuple[torch.Tensor, ...]:
    """Return the unit normals of bicubic interpolation and of the network.

    Parameters
    ----------
    low
        ``(B, 3, h, w)`` input of the network.
    output
        ``(B, 5, s h, s w)`` output of the network.
    scale
        s.
    """
    from torch.nn.functional import interpolate, normalize

    bicubic = interpolate(low, scale_factor=scale, mode="bicubic", align_corners=False)
    return normalize(bicubic, dim=1), normalize(bicubic + output[:, :3], dim=1)


def squared_chord(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    """Return the squared distance of the ends of ``(B, 3, h, w)`` unit vectors."""
    return ((first - second) ** 2).sum(1)


def squared_angle(chord2: torch.Tensor) -> torch.Tensor:
    """Return the squared angle in radian of squared chords."""
    return (2 * (0.5 * chord2.sqrt()).clamp(max=1).asin()) ** 2


def loss(low: torch.Tensor, high: torch.Tensor, output: torch.Tensor, scale: int) -> torch.Tensor:
    """Return the mean chord between normals and target, plus a little of the likelihood.

    The likelihood is that of two normally distributed tangent components, ln v + e^2 / v, whose
    expectation is smallest if v is the mean square of the angle e. It does not change the normals
    through e, only through what the layers have in common.
    """
    import torch

    bicubic, normals = results(low, output, scale)
    chord2 = squared_chord(normals, high)
    with torch.no_grad():
        chords2 = torch.stack([chord2, squared_chord(bicubic, high)], 1)
        squares = squared_angle(chords2) + _ROUNDING
    logs = output[:, 3:]
    likelihood = (logs + squares * torch.exp(-logs)).mean()
    return (chord2 + _SMOOTHING).sqrt().mean() + _LIKELIHOOD * likelihood
