"""What the options of remedies leave of the harm, on simulated scenes of known shape."""

from functools import cache

import pytest

from acquisition import SRGB, angle_deg
from benchmarks.imperfections.cases import CASES
from benchmarks.imperfections.recordings import built
from benchmarks.imperfections.remedies import Remedy
from benchmarks.imperfections.scenes import SCENES
from benchmarks.imperfections.trials import Trial
from tests.cases import cases

pytestmark = pytest.mark.slow

SIZE = (180, 144)
SEED = 77
LENS = {"kind": "perspective", "width": 480, "height": 384, "sharp": False}
PAINT = {"kind": "paint", "low": 0.3, "high": 0.7, "wavelength_mm": 40}
OBJECTS = {
    "leather": SCENES["leather"],
    "coin": SCENES["coin"],
    "textured": SCENES["textured"],
    "few lights": SCENES["few"],
    # Each sample of its rim is in shadow under half of the lights.
    "hemisphere": {
        "object": {"kind": "cap", "radius_mm": 60, "height_mm": 59},
        "pattern": PAINT,
    },
}
# Imperfection, its strength, and the options of its remedy.
REMEDIES = {
    "room light": ("room_light", 0.15, Remedy("-", keywords={"ambient": "estimate"})),
    "weak room light": ("room_light", 0.05, Remedy("-", keywords={"ambient": "estimate"})),
    "strengths": ("strengths_wrong", 0.05, Remedy("-", keywords={"semi_calibrated": True})),
    "sRGB": ("srgb_as_16bit", 1, Remedy("-", transfer=SRGB)),
    "dome": ("directions_only", 1, Remedy("-", keywords={"light_distance_mm": 450.0})),
}
# Of the clean error; degrees that do not matter.
BAR, SLIGHT = 1.3, 0.05


@cache
def recorded(name):
    """Return the recording and its clean error in degrees."""
    table = {"ambient": 0.002, "board": {"kind": "even", "albedo": 0.05}, "lens": LENS}
    recording = built(name, table | {"lights": {"kind": "dome"}} | OBJECTS[name], SEED, SIZE)
    return recording, Trial(recording).outcome(recording).error_deg


# Height and strengths of the hemisphere are not found together well enough.
LEFT_OUT = {("strengths", "hemisphere")}
# The others are the same on these objects.
LEFT_OUT |= {("weak room light", name) for name in OBJECTS if name != "leather"}
LEFT_OUT |= {(remedy, "textured") for remedy in ("room light", "sRGB", "dome")}
LEFT_OUT |= {("sRGB", "coin"), ("sRGB", "few lights"), ("dome", "coin"), ("dome", "hemisphere")}
TRIED = {
    f"{remedy}, {name}": (remedy, name)
    for remedy in REMEDIES
    for name in OBJECTS
    if (remedy, name) not in LEFT_OUT
}


@cases(("remedy", "name"), TRIED)
def test_a_remedy_restores_the_clean_error(tmp_path, remedy, name):
    case, strength, options = REMEDIES[remedy]
    recording, clean = recorded(name)
    changed = CASES[case].change(recording, strength)
    made = changed.reconstructed(tmp_path / "images", options)
    found = made.normals.normals, recording.normals
    seen = recording.mask & made.valid
    error = angle(*found, seen)
    assert error < BAR * clean + SLIGHT


def angle(first, second, where):
    return float(angle_deg(first[where], second[where]).mean())


def test_images_on_another_scale_are_divided(tmp_path):
    """They are not left out; the factor is that of the fault."""
    recording, clean = recorded("hemisphere")
    changed = CASES["one_brighter"].change(recording, 0.2)
    options = Remedy("-", keywords={"exclude_disagreeing": True})
    made = changed.reconstructed(tmp_path / "images", options)
    name = recording.lights.ids[len(recording.lights) // 3]
    assert made.excluded == ()
    assert list(made.rescaled) == [name]
    assert made.rescaled[name] == pytest.approx(1.2, rel=0.01)
    assert angle(made.normals.normals, recording.normals, recording.mask & made.valid) < BAR * clean
    assert [n.code for n in made.warnings if n.code.startswith("images-")] == ["images-rescaled"]
