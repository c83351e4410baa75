"""What can go wrong on the bench. Every message says what, where and what to do, in one line."""


class RigError(Exception):
    """The rig cannot do what was asked (exit code 3 at the front door)."""


class BoardError(RigError):
    """The LED board or its serial line failed; the message names port, command and LED."""


class CameraError(RigError):
    """The camera failed; the message names the node or the frame that was awaited."""


class FrameTimeoutError(CameraError):
    """A frame did not come in time, and the camera has nothing to say about it."""


class RigConfigError(RigError):
    """A rig file or rig name is not understood."""


class RigNotFoundError(RigConfigError):
    """There is no rig of this name, or no such rig file (exit code 2 at the front door)."""
