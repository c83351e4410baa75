"""The pytest plugin, run as in another project."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import sgp.sessions
from simulator import open_rig_seeing, render, scene_named

pytest_plugins = ["pytester"]

GUIDE = Path(__file__).parents[2] / "docs" / "testing-without-hardware.md"
# The plugin is loaded by its entry point, as in another project.
STRICT = ("-W", "error", "--strict-markers", "--strict-config")


@pytest.fixture(scope="module", autouse=True)
def _loaded():
    """Import and compile everything first: inner runs share this process but unload imports."""
    with open_rig_seeing(
        render(scene_named("spheres", width=32, height=32, leds=2)), realtime=False
    ) as rig:
        rig.shoot(0, 100)


@pytest.fixture
def run(pytester):
    """Run one test file in this process and return the result."""

    def run(source, ini=""):
        pytester.makeini(f"[pytest]\n{ini}")
        pytester.makepyfile(source)
        return pytester.runpytest_inprocess(*STRICT)

    return run


@pytest.mark.slow
def test_the_guides_example_works(pytester):
    """Write every code block of the guide to a file, and run them in a new interpreter."""
    blocks = re.findall(r"```(ini|python)\n(.*?)```", GUIDE.read_text(), re.DOTALL)
    assert [kind for kind, _ in blocks] == ["ini", "python", "python"]
    pytester.makefile(".ini", pytest=blocks[0][1])
    for _, text in blocks[1:]:
        name = re.match(r"# (\w+)\.py\n", text)[1]
        pytester.makepyfile(**{name: text})
    result = pytester.runpytest_subprocess(*STRICT)
    result.assert_outcomes(passed=4)


def test_the_guides_ini_file_states_the_defaults():
    stated = re.findall(r"^sgp_(\w+) = (\S+)$", GUIDE.read_text(), re.MULTILINE)
    assert dict(stated) == {
        "scene": "coin",
        "size": "160x128",
        "leds": "12",
        "seed": "0",
        "noise": "true",
    }


def test_rig_is_ready_and_closed_afterwards(run):
    result = run(
        """
        import numpy as np
        import pytest
        from rig import RigError

        opened = []

        def test_shoots(simulated_rig):
            opened.append(simulated_rig)
            dark, lit = simulated_rig.shoot(None, 20_000), simulated_rig.shoot(3, 20_000)
            assert lit.led == 3
            assert lit.frame.pixels.shape == (128, 160)
            assert lit.frame.pixels.mean() > 2 * dark.frame.pixels.mean()
            assert simulated_rig.config.leds == 12

        def test_after():
            with pytest.raises(RigError):
                opened[0].shoot(0, 20_000)
        """
    )
    result.assert_outcomes(passed=2)


def test_session_is_complete_and_each_test_has_its_own(run):
    result = run(
        """
        import pytest
        from acquisition import Session, read_source, verify_session

        @pytest.mark.parametrize("turn", [0, 1])
        def test_spoil_it(simulated_session, simulated_truth, turn):
            session = Session.open(simulated_session)
            assert session.complete
            assert verify_session(simulated_session).ok
            source = read_source(simulated_session)
            assert len(source.frames) == 13
            assert (simulated_session / "derived/truth/lights.json").is_file()
            (simulated_session / "frames" / "L03_E0.tif").unlink()
            with pytest.raises(ValueError, match="read-only"):
                simulated_truth.normals[0, 0] = 1
        """
    )
    result.assert_outcomes(passed=2)


def test_session_is_recorded_once_for_each_scene(run, monkeypatch):
    recorded = []
    record = sgp.sessions.record_simulated
    monkeypatch.setattr(
        sgp.sessions,
        "record_simulated",
        lambda *args, **more: recorded.append(more["seed"]) or record(*args, **more),
    )
    result = run(
        """
        import pytest

        @pytest.mark.parametrize("turn", range(3))
        def test_same(simulated_session, turn):
            assert simulated_session.is_dir()

        @pytest.mark.sgp(seed=4)
        def test_other(simulated_session):
            assert simulated_session.is_dir()
        """
    )
    result.assert_outcomes(passed=4)
    assert recorded == [0, 4]


def test_ini_and_the_closest_marker_decide(run):
    result = run(
        """
        import pytest

        pytestmark = pytest.mark.sgp(leds=5, seed=1)

        @pytest.mark.sgp(seed=2)
        class TestClass:
            @pytest.mark.sgp(size="48x32")
            def test_near(self, simulated_rig, simulated_truth):
                assert simulated_truth.size == (32, 48)
                assert simulated_rig.config.leds == 5
                assert len(simulated_truth.sphere_radii_mm) == 4
                TestClass.lights = simulated_truth.lights

        def test_far(simulated_truth):
            assert simulated_truth.size == (40, 64)
            assert len(simulated_truth.lights) == 5
            assert (simulated_truth.lights.positions_mm != TestClass.lights.positions_mm).all()
        """,
        ini="sgp_size = 64x40\nsgp_scene = spheres\nsgp_leds = 7\nsgp_seed = 3\n",
    )
    result.assert_outcomes(passed=2)


def test_a_scene_file_next_to_the_ini_file_has_its_own_size_and_lights(run, pytester):
    pytester.makefile(
        ".toml",
        hill="""
        [object]
        kind = "cap"
        radius_mm = 60.0
        height_mm = 20.0
        [lights]
        kind = "ring"
        count = 3
        [lens]
        kind = "orthographic"
        width = 40
        height = 30
        pixel_mm = 5.0
        height_mm = 600.0
        """,
    )
    result = run(
        """
        import pytest

        def test_as_it_is(simulated_rig, simulated_session, simulated_truth):
            assert simulated_truth.size == (30, 40)
            assert simulated_truth.camera is None
            assert simulated_rig.config.leds == 3
            assert len(list((simulated_session / "frames").glob("L*.tif"))) == 3

        @pytest.mark.sgp(leds=5, size="20x15")
        def test_more_lights(simulated_truth):
            assert simulated_truth.size == (15, 20)
            assert len(simulated_truth.lights) == 5
        """,
        ini="sgp_scene = hill.toml",
    )
    result.assert_outcomes(passed=2)


def test_the_same_seed_gives_the_same_frames_and_no_noise_none(run):
    result = run(
        """
        import numpy as np
        import pytest

        shots = {}

        @pytest.mark.parametrize("turn", [0, 1])
        def test_noisy(simulated_rig, turn):
            first, second = (simulated_rig.shoot(1, 20_000).frame.pixels for _ in range(2))
            assert (first != second).any()
            np.testing.assert_array_equal(first, shots.setdefault("noisy", first))

        @pytest.mark.sgp(noise=False)
        def test_without_noise(simulated_rig):
            first, second = (simulated_rig.shoot(1, 20_000).frame.pixels for _ in range(2))
            np.testing.assert_array_equal(first, second)
        """
    )
    result.assert_outcomes(passed=3)


BAD_MARKERS = {
    "colour=1": "accepts scene, size, leds, seed, noise as keywords, not 'colour'",
    "'coin'": "as keywords, not 'coin'",
    "scene='moon'": "'moon'",
    "scene='moon.toml'": "moon.toml: no such file",
    "scene=3": "scene 3 is not a name",
    "size='64'": "size '64' must have the form 160x128",
    "size=(64, 48)": "size (64, 48) must have the form 160x128",
    "leds=0": "leds 0 is not a whole number of at least 1",
    "seed=-1": "seed -1 is not a whole number of at least 0",
}


def _complaints(result):
    assert not re.search("Traceback|exception|Error", result.stdout.str())
    return [line for line in result.outlines if line.startswith(("sgp: ", "the marker sgp "))]


def test_an_impossible_scene_gets_one_line(run):
    tests = "".join(
        f"@pytest.mark.sgp({marker})\ndef test_{i}(simulated_truth):\n    pass\n"
        for i, marker in enumerate(BAD_MARKERS)
    )
    result = run(f"import pytest\n{tests}")
    result.assert_outcomes(errors=len(BAD_MARKERS))
    for complaint, expected in zip(_complaints(result), BAD_MARKERS.values(), strict=True):
        assert expected in complaint


@pytest.mark.parametrize(
    ("ini", "complaint"),
    [
        ("sgp_leds = many", "leds 'many' is not a whole number of at least 1"),
        ("sgp_noise = perhaps", "noise 'perhaps' is neither true nor false"),
    ],
)
def test_an_impossible_ini_option_gets_one_line(run, ini, complaint):
    result = run("def test_it(simulated_rig):\n    pass\n", ini)
    result.assert_outcomes(errors=1)
    assert _complaints(result) == [f"sgp: {complaint}"]


def test_runs_that_do_not_use_it_are_not_affected(run):
    plain = "def test_it():\n    pass\n"
    run(plain).assert_outcomes(passed=1)


def test_nothing_heavy_is_imported_at_the_start():
    heavy = [
        "numpy",
        "numba",
        "cv2",
        "scipy",
        "pydantic",
        "rich",
        "simulator",
        "acquisition",
        "rig",
    ]
    program = f"import sys, sgp.pytest_plugin; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"
