"""From linear images to normals, shape, detail and geometry.

Normals from images::

    reconstruct              normals, albedo and height of a recording
    Reconstruction           the result of `reconstruct`
    photometric_stereo       normals and albedo of a stack under known lights
    PhotometricStereoResult  the result of `photometric_stereo`
    normals_of_frames        the same from the frames of a camera, in place
    StereoMaps               maps for `normals_of_frames`
    Method                   names of the methods
    SampleKind               what a sample shows

Normal maps::

    NormalMap                unit vectors and a mask
    read_normals             read a map from an image or a folder
    NormalMapFile            a map that was read, with warnings
    find_normals             the files that `read_normals` would read
    write_normals            write normals.exr, normals.png and mask.png
    angular_error            compare a map with the truth
    AngularError             the result of `angular_error`
    ssim                     structural similarity of two maps

Shape and detail::

    separate                 split a map into shape and detail
    Separation               shape and detail
    ShapeFilter              the low-pass filter that separates them
    combine                  join shape and detail
    transfer                 move a detail to another shape
    transfer_local           move the coarse detail of a part
    TransferResult           the result of a transfer
    Tile                     how copies of a small detail are joined
    synthesize               continue a detail over a sheet
    synthesize_onto          continue a detail over a surface
    Synthesis                a synthesised detail
    SynthesisMethod          names of the methods
    fill_holes               fill damaged parts of a map
    super_resolve            enlarge a map
    SuperResolution          an enlarged map
    SuperResolutionModel     a network for `super_resolve`

Heights and meshes::

    integrate                heights from normals
    HeightMap                a surface
    HeightPrior              known heights
    height_profile           compare the heights of two surfaces
    HeightProfile            the result of `height_profile`
    normal_curl              where normals contradict each other
    normal_residual          where a surface differs from its normals
    height_mesh              a mesh of a surface
    solid_mesh               close a mesh to a solid
    write_mesh               write a mesh
    project                  normals of a mesh or a point cloud
    read_geometry            read a mesh or a point cloud
    Geometry                 a mesh or a point cloud

Namespaces: changes, checks, colour, curvatures, detail, maps, merging, meshes, near, noise,
projection, recording, registration, relight, roughness, series, stages, stereo, superres, surface,
synthesis.
"""

import lazy_loader

import rig as _rig  # noqa: F401 - adapts the cache of the kernels

# The names are listed in __init__.pyi; each is loaded when it is first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
