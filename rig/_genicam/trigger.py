"""Trigger settings of a camera: a software command, a line, or free running."""

from __future__ import annotations

from rig._camera import Trigger
from rig._errors import CameraError
from rig._genicam.nodes import Nodes

TRIGGER_NODES = (("TriggerMode",), ("TriggerSource",))
COMMAND = "TriggerSoftware"
# The selector's symbol for "one frame per trigger", the first that a camera offers.
_FRAME = ("FrameStart", "ExposureStart")


class TriggerControl:
    """The trigger nodes of a camera, for use while it is not acquiring.

    Parameters
    ----------
    nodes
        Nodes of the camera.
    line
        Symbol of the trigger source that is wired to the LED board.
    """

    def __init__(self, nodes: Nodes, line: str) -> None:
        self._nodes = nodes
        self._line = line

    def choose(self, trigger: Trigger) -> None:
        """Set the camera to take exactly one frame for each trigger of this kind.

        Raises
        ------
        CameraError
            If the camera cannot do this; if it lacks the line, the message lists its lines.
        """
        self.free()
        nodes = self._nodes
        self._select_frames()
        nodes.set_choice("TriggerSource", "Software" if trigger == "software" else self._line)
        if trigger == "line":
            self._make_input()
        nodes.set_choice("TriggerMode", "On")

    def free(self) -> None:
        """Turn off all triggers, so that the camera runs freely."""
        nodes = self._nodes
        if nodes.has("AcquisitionMode"):
            nodes.set_choice("AcquisitionMode", "Continuous")
        if not nodes.has("TriggerMode"):
            return
        if nodes.can_set("TriggerSelector"):
            for symbol in nodes.choices("TriggerSelector"):
                nodes.set_choice("TriggerSelector", symbol)
                if nodes.has("TriggerMode"):
                    nodes.set_choice("TriggerMode", "Off")
        else:
            nodes.set_choice("TriggerMode", "Off")

    def fire(self) -> None:
        """Trigger one frame by software."""
        self._nodes.execute(COMMAND)

    def _select_frames(self) -> None:
        nodes = self._nodes
        if not nodes.has("TriggerSelector"):
            return
        offered = nodes.choices("TriggerSelector")
        symbol = next((symbol for symbol in _FRAME if symbol in offered), None)
        if symbol is None:
            raise CameraError(
                f"camera {nodes.camera}, TriggerSelector: none of {', '.join(_FRAME)} is "
                f"available, only {', '.join(offered)}"
            )
        nodes.set_choice("TriggerSelector", symbol)

    def _make_input(self) -> None:
        nodes = self._nodes
        if nodes.has("TriggerActivation"):
            nodes.set_choice("TriggerActivation", "RisingEdge")
        if nodes.can_set("LineSelector") and self._line in nodes.choices("LineSelector"):
            nodes.set_choice("LineSelector", self._line)
            if nodes.has("LineMode"):
                nodes.set_choice("LineMode", "Input")
