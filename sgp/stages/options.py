"""Options of the stages after the normals, which `sgp run` shares with their own commands."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cyclopts import Parameter

import acquisition
import processing
from rig.arrays import Bool
from sgp.cli.console import with_progress
from sgp.cli.exit import UsageError
from sgp.cli.options import Count, Green, Order, Positive, Triangles


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class MapOptions:
    """Options for writing normal maps.

    Parameters
    ----------
    green_out
        Direction of the green channel in the PNGs that are written; down is the convention of
        DirectX. EXR files always hold the vectors themselves.
    """

    green_out: Green = "up"

    def write(
        self, folder: Path, normals: acquisition.MapRows, mask: Bool, name: str = "normals"
    ) -> dict[str, Path]:
        """Write a map with its mask, and show the progress; return the files."""
        write = with_progress(processing.maps.write_normal_rows)
        return write(folder, normals, mask, name, green=self.green_out)

    def write_map(self, folder: Path, normal_map: processing.NormalMap) -> dict[str, Path]:
        """Write a map of normals as `write` does."""
        return self.write(folder, normal_map.normals, normal_map.mask)


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class SeparationOptions:
    """Options for splitting a normal map into shape and detail.

    Parameters
    ----------
    filter
        Low-pass filter for the shape component: gaussian, box, guided or bilateral. The last two
        do not smooth across steps and occlusions.
    order
        Order of the Gaussian; the paper uses 1.
    w
        Half width of the filter window in pixels; sigma is w / 2.
    """

    filter: processing.detail.FilterKind = "gaussian"
    order: Order = 8
    w: Count = 5

    def shape_filter(self) -> processing.ShapeFilter:
        """Return the filter with these parameters."""
        return processing.ShapeFilter(self.filter, self.order, self.w)

    def stage(self) -> processing.detail.SeparationStage:
        """Return the separation with this filter."""
        return processing.detail.SeparationStage(self.shape_filter())


# What a command has by default.
MAPS, SEPARATION = MapOptions(), SeparationOptions()


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class SurfaceOptions:
    """Options for computing and writing a surface.

    Parameters
    ----------
    pixel_mm
        Size of a pixel on the object in mm; without it and without a working distance, the unit of
        heights and meshes is one pixel. Under lights with positions and without a camera, the view
        is that of a telecentric lens whose axis is in the middle of the image.
    glb
        Also write surface.glb, in metres as glTF requires, with the albedo as its texture.
    normal_texture
        Write surface.glb with the normals as a texture, for programs that simplify the mesh.
    stl
        Also write surface.stl.
    obj
        Also write surface.obj, with surface.mtl and the albedo as its texture.
    triangles
        Number of triangles to keep in every mesh; vertices are removed where the surface is
        flattest, and the distance from the surface is reported; default: all triangles.
    close
        Also write solid.stl, a watertight solid for printing and CAD: the surface, walls and a flat
        base.
    base
        Thickness of the base of solid.stl below the lowest point, in mm, or in pixels if the scale
        is not known; default: 2 % of the longer side. Implies --close.
    discontinuity
        Keep jumps in depth, where one part of the object hides another, in any case; without this
        option, if the normals show them. Meshes are cut there, and discontinuity.png, jumps.png and
        parts.png show what was found.
    smooth
        Look for no jumps: the surface is one smooth piece.
    height_sigma
        Also write height_sigma.exr, the standard deviation of each height, from simulated errors of
        the normals, and report that of differences in height; about 6 CPU seconds per million
        pixels. Requires standard deviations of the normals.
    k
        How small the jumps are that count; steps of 1 / sqrt(k) pixels begin to be jumps; default:
        4.
    """

    pixel_mm: Positive | None = None
    glb: bool = False
    normal_texture: bool = False
    stl: bool = False
    obj: bool = False
    triangles: Triangles | None = None
    close: bool = False
    base: Positive | None = None
    discontinuity: bool = False
    smooth: bool = False
    k: Positive | None = None
    height_sigma: bool = False

    def jumps(self) -> bool | None:
        """Return whether the surface may jump; None if the normals decide."""
        if self.smooth and self.discontinuity:
            raise UsageError("--smooth and --discontinuity exclude each other: give one of them")
        return False if self.smooth else self.discontinuity or None

    def sharpness(self) -> float:
        """Return the k of jumps, and refuse options that exclude each other."""
        if self.jumps() is False and self.k is not None:
            raise UsageError("--k is for jumps in depth, which --smooth excludes: leave it out")
        return 4.0 if self.k is None else self.k

    def formats(self) -> tuple[str, ...]:
        """Return the suffixes of the meshes to write."""
        wanted = {"glb": self.glb or self.normal_texture, "stl": self.stl, "obj": self.obj}
        return ("ply", *(name for name, asked in wanted.items() if asked))

    def whole_surface(self) -> dict[str, bool]:
        """Return the options that need the complete surface in memory, and which are given."""
        whole = {"--discontinuity": self.discontinuity, "--height-sigma": self.height_sigma}
        return whole | self.whole_mesh()

    def whole_mesh(self) -> dict[str, bool]:
        """Return the options that need the complete mesh in memory, and which are given."""
        return {
            "--glb": self.glb,
            "--normal-texture": self.normal_texture,
            "--obj": self.obj,
            "--triangles": self.triangles is not None,
            "--close": self.close,
            "--base": self.base is not None,
        }


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class RelightOptions:
    """Options for fitting functions of the direction of the light.

    Parameters
    ----------
    basis
        ptm (polynomial with 6 coefficients), hsh4 or hsh9 (hemispherical harmonics with 4 or 9).
    colours
        lrgb (one function per pixel and a colour that it is multiplied by) or rgb (one function per
        channel, for coloured highlights; the files are about twice as large).
    values
        display (samples of the sRGB curve, as viewers show them) or linear (proportional to light,
        for further computation).
    """

    basis: processing.relight.LightBasis = "ptm"
    colours: processing.relight.RelightColours = "lrgb"
    values: processing.relight.RelightValues = "display"
