"""Calibration of lights, and conversion of raw frames to linear radiance.

Linear images::

    linear_stack             read a recording as linear images
    open_stack               the same, made where they are read
    raw_stack                linear grey images, kept as raw frames where possible
    Stack                    linear images under N lights
    StackNoise               variance of their samples

Lights::

    calibrate_spheres        directions or positions from mirror spheres
    calibrate_moved_spheres  the same from several recordings with moved spheres
    apply_spheres            lights from mirror spheres next to the object
    find_spheres             find the mirror spheres in images
    SphereCalibration        lights from spheres, and the quality of the fit
    Sphere                   one of these spheres
    calibrate_intensities    intensities and radiation patterns from matte surfaces
    MatteSurface             images of a matte surface
    compare_lights           compare two calibrations
    LightComparison          their differences

Camera and sensor::

    calibrate_camera         camera matrix and distortion from views of a board
    CameraCalibration        a camera with its standard deviations
    CharucoBoard             a calibration board
    read_board               read a board from board.json
    find_board               find the corners of a board in an image
    calibrate_sensor         gain and noise by photon transfer
    calibrate_flat           a flat field from a white card

    EstimateError            the input does not determine the estimate

Namespaces: camera, comparison, flat, intensities, radiance, sensor, spheres.
"""

import lazy_loader

# The names are listed in __init__.pyi; each is loaded when it is first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
