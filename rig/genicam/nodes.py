"""Access to the nodes of a camera by any of the names that vendors give them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from genicam import genapi

from rig._errors import CameraError
from rig.genicam.errors import GENICAM_ERRORS, camera_errors

Names = str | Sequence[str]
Setting = bool | int | float | str

_READABLE = (genapi.EAccessMode.RO, genapi.EAccessMode.RW)
_WRITABLE = (genapi.EAccessMode.WO, genapi.EAccessMode.RW)
# A value read back may differ from the one set by the rounding of a float register.
_ROUNDING = 1e-6
# Digits of a number that are recorded: a register may round the last ones differently.
_DIGITS = 6
_FLAG, _CHOICE, _NUMBER = (
    (genapi.IBoolean,),
    (genapi.IEnumeration,),
    (genapi.IInteger, genapi.IFloat),
)
# More entries than a selector has for channels or taps: it selects places of a table.
_MOST_ENTRIES = 32


class Nodes:
    """Access to the node map of a camera; every error message names the camera and the node.

    If a method takes several names, the first one that this camera has is used.

    Parameters
    ----------
    node_map
        genicam's ``NodeMap``.
    camera
        Name of the camera in messages.
    """

    def __init__(self, node_map: Any, camera: str) -> None:
        self._map = node_map
        self.camera = camera

    def exists(self, names: Names) -> bool:
        """Return whether the camera has this node, even if it is locked now."""
        return self._access(names) not in (None, genapi.EAccessMode.NI)

    def has(self, names: Names) -> bool:
        """Return whether the camera has this node and it can be read now."""
        return self._access(names) in _READABLE

    def can_set(self, names: Names) -> bool:
        """Return whether the camera has this node and it can be written now."""
        return self._access(names) in _WRITABLE

    def name(self, names: Names) -> str:
        """Return the name that this camera uses, or the first if it has none of them."""
        listed = [names] if isinstance(names, str) else list(names)
        return next((name for name in listed if self._map.has_node(name)), listed[0])

    def names(self) -> tuple[str, ...]:
        """Return the names of the camera's booleans, enumerations and numbers."""
        nodes = [node for node in self._map.nodes if isinstance(node, (*_FLAG, *_CHOICE, *_NUMBER))]
        # Other nodes are registers behind these. A map without categories does not state which.
        features = [node for node in nodes if node.node.is_feature()] or nodes
        return tuple(str(node.node.name) for node in features)

    def entries(self, name: str) -> Iterator[str]:
        """Select each entry of a node's selector in turn, yield it, and restore the first one.

        Yields an empty text once if the node has no selector that can be changed.
        """
        selectors = [str(one.node.name) for one in self._node(name).node.selecting_features]
        selector = next(iter(selectors), f"{name}Selector")
        if not self.can_set(selector) or not self.is_choice(selector):
            yield ""
            return
        before = self.text(selector)
        try:
            for symbol in self.choices(selector)[:_MOST_ENTRIES]:
                self.set_choice(selector, symbol)
                yield symbol
        finally:
            self.set_choice(selector, before)

    def value(self, name: str) -> Setting:
        """Read a boolean, a number or the symbol of an enumeration."""
        if self.is_flag(name):
            return self.flag(name)
        if self.is_choice(name):
            return self.text(name)
        number = self.number(name)
        if not math.isfinite(number):
            return str(number)
        return int(number) if number.is_integer() else float(f"{number:.{_DIGITS}g}")

    def number(self, names: Names) -> float:
        """Read a number."""
        return float(self._read(names))

    def text(self, names: Names) -> str:
        """Read a string, or the symbol of an enumeration."""
        return str(self._read(names))

    def flag(self, names: Names) -> bool:
        """Read a boolean."""
        return bool(self._read(names))

    def limits(self, names: Names) -> tuple[float, float]:
        """Read the range of a number."""
        node = self._node(names)
        with camera_errors(self._where(names)):
            return float(node.min), float(node.max)

    def unit(self, names: Names) -> str:
        """Read the unit of a number as the camera states it, empty if it states none."""
        try:
            return str(self._node(names).unit or "").strip()
        except GENICAM_ERRORS:
            return ""

    def choices(self, names: Names) -> tuple[str, ...]:
        """Return the symbols of an enumeration that can be chosen now."""
        node = self._node(names)
        with camera_errors(self._where(names)):
            return tuple(
                str(entry.symbolic)
                for entry in node.entries
                if entry.get_access_mode() in _READABLE
            )

    def first_offered(self, names: Names, symbols: Iterable[str]) -> str | None:
        """Return the first of these symbols that an enumeration offers; None if it offers none."""
        offered = self.choices(names)
        return next((symbol for symbol in symbols if symbol in offered), None)

    def set_number(self, names: Names, value: float, unit: str = "") -> float:
        """Write a number, rounded to the nearest step of the camera, and return it as read back.

        Raises
        ------
        CameraError
            If the value is outside the camera's range (the message states the range), or if it
            cannot be written.
        """
        node = self._node(names)
        where = self._where(names)
        unit = f" {unit}" if unit else ""
        low, high = self.limits(names)
        if not low <= value <= high:
            raise CameraError(
                f"{where}: {value:g}{unit} is outside its range of {low:g} to {high:g}{unit}"
            )
        with camera_errors(f"{where}, set to {value:g}{unit}"):
            node.value = _stepped(node, value, low, high)
        return self.number(names)

    def is_choice(self, names: Names) -> bool:
        """Return whether a node is an enumeration."""
        return isinstance(self._node(names), _CHOICE)

    def is_flag(self, names: Names) -> bool:
        """Return whether a node is a boolean."""
        return isinstance(self._node(names), _FLAG)

    def is_number(self, names: Names) -> bool:
        """Return whether a node is a number."""
        return isinstance(self._node(names), _NUMBER)

    def set_choice(self, names: Names, symbol: str) -> bool:
        """Choose a symbol of an enumeration and read it back; return whether it has changed.

        Raises
        ------
        CameraError
            If the symbol cannot be chosen (the message lists those that can), or if the camera
            keeps another one.
        """
        where = self._where(names)
        # Written only if needed: many cameras lock nodes that cannot be changed.
        if self.text(names) == symbol:
            return False
        choices = self.choices(names)
        if symbol not in choices:
            raise CameraError(f"{where}: {symbol!r} is not available, only {', '.join(choices)}")
        with camera_errors(f"{where}, set to {symbol}"):
            self._node(names).value = symbol
        if (current := self.text(names)) != symbol:
            raise CameraError(f"{where}: was set to {symbol} but is still {current}")
        return True

    def set_flag(self, names: Names, *, on: bool) -> bool:
        """Write a boolean and read it back; return whether it has changed."""
        where = self._where(names)
        node = self._node(names)
        with camera_errors(f"{where}, set to {on}"):
            if bool(node.value) == on:
                return False
            node.value = on
            if bool(node.value) != on:
                raise CameraError(f"{where}: was set to {on} but is still {not on}")
        return True

    def execute(self, names: Names) -> None:
        """Execute a command."""
        node = self._node(names)
        with camera_errors(self._where(names)):
            node.execute()

    def _read(self, names: Names) -> Any:
        node = self._node(names)
        with camera_errors(self._where(names)):
            return node.value

    def _where(self, names: Names) -> str:
        return f"camera {self.camera}, {self.name(names)}"

    def _node(self, names: Names) -> Any:
        name = self.name(names)
        if not self._map.has_node(name):
            raise CameraError(f"camera {self.camera} has no node {name}")
        return self._map.get_node(name)

    def _access(self, names: Names) -> Any:
        name = self.name(names)
        if not self._map.has_node(name):
            return None
        try:
            return self._map.get_node(name).get_access_mode()
        except GENICAM_ERRORS:
            return None


def _stepped(node: Any, value: float, low: float, high: float) -> float | int:
    """Return the value nearest to ``value`` that the node can take."""
    whole = isinstance(node, genapi.IInteger)
    step = float(node.inc) if whole or node.has_inc() else 0.0
    if step > 0:
        steps = min(round((value - low) / step), math.floor((high - low) / step + _ROUNDING))
        value = low + steps * step
    return round(value) if whole else value
