"""Recordings: plans, sessions, image files, and the values of lights, camera and sensor.

Record with a rig::

    CapturePlan         settings of a recording
    read_plan           read a plan from a TOML file
    record              take and store every shot of a plan
    resume              take the missing shots of a session
    RecordingHooks      callbacks of a recording
    Labels              object, operator and place of a recording
    Calibrations        calibrations to store with a recording
    watch_folder        record the images that another program writes into a folder
    compare_frames      shift, gain and focus of two frames of the same light

Read recordings::

    read_source         read a recording of any kind, without its pixels
    Source, Frame       a recording, and one of its images
    crop                take a rectangular region of a recording
    downscale           reduce its resolution
    exclude             leave images and their lights out
    import_frames       store a recording as a session
    Session             a recorded session
    verify_session      check all files of a session
    Identity, Setup     what a recording states of object and rig

Images and masks::

    read_image          read an image as it is stored
    write_exr           write an image of floating-point numbers
    write_png           write an image of 8 or 16 bits
    read_mask           read a mask
    write_mask          write a mask
    TransferCurve       how samples depend on light; LINEAR and SRGB are two

Lights, camera and sensor::

    Lights              directions or positions, and intensities
    LightErrors         their covariances and standard deviations
    read_lights         read lights
    write_lights        write lights
    CameraModel         a camera with its lens distortion
    read_camera         read a camera
    write_camera        write a camera
    NoiseModel          gain, offset and noise of a sensor
    MeasuredSensor      figures of a measured sensor
    Flat                a flat field
    angle_deg           angles between vectors

Files and errors::

    write_durably       write a file completely or not at all
    make_folder         create a folder and its parents
    MapRows             what arrays and maps in files have in common
    missing_path        the error about a path that does not exist
    DataError           an input is damaged, incomplete or inconsistent
    MissingPathError    a path does not exist
    NotAcceptedError    a finding makes a recording useless
    SessionInUseError   another process writes to the session
    StorageError        the disk refused a write

Namespaces: comparison, engine, exports, files, imports, mesh_files, metering, pixels, plan,
preflights, selftests, session, source, value_files, values.
"""

import lazy_loader

import rig as _rig  # noqa: F401 - adapts the cache of the kernels

# The names are listed in __init__.pyi; each is loaded when it is first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
