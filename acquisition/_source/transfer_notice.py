"""The notice about a transfer curve that no one has given."""

from __future__ import annotations

from acquisition._values.transfer_curve import LINEAR, TransferCurve
from rig import Notice

_WHITE_8_BIT = 255


def transfer_notices(
    curve: TransferCurve, origin: str, white_level: float, where: str
) -> tuple[Notice, ...]:
    """Return a notice about a curve that was chosen, or nothing if there was hardly a choice.

    Samples of more than 8 bits are linear unless metadata say otherwise: that needs no notice. A
    colour profile is always mentioned, also one that cannot be used, and so is an unknown transfer.
    """
    mentioned = "profile" in origin or "unknown" in origin
    if curve == LINEAR and white_level > _WHITE_8_BIT and not mentioned:
        return ()
    text = f"the samples are read as {curve.name} ({origin})"
    return (Notice("transfer-curve", text, where, "info"),)
