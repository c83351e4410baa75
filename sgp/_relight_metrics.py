"""The figures of `sgp export` and `sgp relight`, which `sgp._metrics` assigns to them."""

from __future__ import annotations

from typing import Annotated, Literal, NotRequired

# Before Python 3.12, pydantic cannot check a `typing.TypedDict`.
from typing_extensions import TypedDict


class RtiMetrics(TypedDict):
    """Figures of an export for viewers of relightable images."""

    fitted_to: Annotated[
        Literal["images", "normals"],
        "",
        "the recorded images, or the shading of normals and albedo if the images are gone",
    ]
    directions: Annotated[
        Literal["distant", "surface", "plane"],
        "",
        "directions of the lights: the same for all pixels; at the points of the surface; or at a "
        "plane at the mean height",
    ]
    lights: Annotated[int, "", "directions that the functions were fitted to"]
    coefficients: Annotated[int, "", "coefficients of a function"]
    pixels: Annotated[int, "px", "pixels of the object"]
    pixels_without_samples: Annotated[
        int, "px", "pixels of the images without any sample, which are black"
    ]
    white: Annotated[float, "white level", "light that is the value 1"]
    fit_rms: Annotated[
        float, "1", "median over the object of the rms deviation of the fit; white is 1"
    ]
    ptm_rms: NotRequired[
        Annotated[float, "1/255", "`--basis ptm`: rms that 8 bits in relight.ptm add"]
    ]
    ptm_largest: NotRequired[Annotated[float, "1/255", "the largest of these deviations"]]
    planes_rms: Annotated[float, "1/255", "rms that 8 bits and JPEG add to the planes"]


class RelightMetrics(TypedDict):
    """Figures of an image under a light."""

    width: Annotated[int, "px", "width of the image"]
    height: Annotated[int, "px", "height of the image"]
    colours: Annotated[Literal["lrgb", "rgb"], "", "one function for all colours, or for each"]
    direction: Annotated[list[float], "1", "unit vector toward the light"]
