"""How a normal map is enlarged, and what its normals are."""

from typing import Literal

SuperResolutionMethod = Literal["bicubic", "normals", "detail"]
# What a normal is: the mean over the area of its pixel, or the normal at its centre.
PixelSampling = Literal["area", "points"]
