"""Lamps over time, compared with closed forms, and their effect on the virtual camera."""

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition import NoiseModel
from simulator.bench import BenchState, BenchWriter
from simulator.camera import VirtualCamera
from simulator.scene import Lamps
from simulator.scene.lamps import gate_share
from tests.simulator.camera_options import grouped

S = 10**9


def test_without_faults_the_factor_of_a_lamp_is_1():
    assert Lamps().factor(3, 7 * S, 123.0, (1, 2)) == 1.0


def test_warm_up_is_the_mean_of_the_exponential_over_the_exposure():
    lamps = Lamps(warm_up=0.2, warm_up_s=30.0)
    # Much shorter than the time constant: the value at that time.
    assert lamps.factor(0, 0, 1.0, ()) == pytest.approx(1.2, rel=1e-7)
    assert lamps.factor(0, 30 * S, 1.0, ()) == pytest.approx(1 + 0.2 / np.e, rel=1e-7)
    assert lamps.factor(0, 3000 * S, 1.0, ()) == pytest.approx(1.0, rel=1e-12)
    # As long as the time constant: (1 - 1/e) of the excess, by integration.
    assert lamps.factor(0, 0, 30e6, ()) == pytest.approx(1 + 0.2 * (1 - 1 / np.e), rel=1e-12)
    assert Lamps(warm_up=-0.1, warm_up_s=5.0).factor(0, 0, 1.0, ()) == pytest.approx(0.9, rel=1e-6)


def test_flicker_has_its_spread_and_depends_only_on_shot_and_led():
    lamps = Lamps(flicker=0.02)
    draws = np.array([lamps.factor(0, i * S, 100.0, (4, i)) for i in range(4000)])
    assert draws.mean() == pytest.approx(1.0, abs=5 * 0.02 / np.sqrt(4000))
    assert draws.std() == pytest.approx(0.02, rel=5 / np.sqrt(2 * 4000))
    assert abs(np.corrcoef(draws[1:], draws[:-1])[0, 1]) < 5 / np.sqrt(4000)
    assert lamps.factor(0, 9 * S, 5.0, (4, 7)) == draws[7]
    assert lamps.factor(1, 9 * S, 5.0, (4, 7)) != draws[7]


@pytest.mark.parametrize(
    ("phase", "cycles", "duty", "share"),
    [
        pytest.param(0.0, 0.25, 0.5, 1.0, id="in the open part"),
        pytest.param(0.5, 0.25, 0.5, 0.0, id="in the dark part"),
        pytest.param(0.25, 0.5, 0.5, 0.5, id="half and half"),
        pytest.param(0.0, 1.0, 0.3, 0.3, id="one cycle"),
        pytest.param(0.77, 3.0, 0.3, 0.3, id="whole cycles at any phase"),
        pytest.param(0.0, 1.5, 0.25, 0.5 / 1.5, id="a cycle and a half"),
        pytest.param(0.9, 0.2, 0.5, 0.5, id="over the edge"),
        pytest.param(0.3, 0.6, 1.0, 1.0, id="always on"),
    ],
)
def test_share_of_a_gate(phase, cycles, duty, share):
    assert gate_share(phase, cycles, duty) == pytest.approx(share, rel=1e-12, abs=1e-15)


@settings(max_examples=60)
@given(
    phase=st.floats(0, 1, exclude_max=True),
    cycles=st.floats(0.01, 20),
    duty=st.floats(0.01, 1),
)
def test_share_of_a_gate_is_the_sum_over_fine_steps(phase, cycles, duty):
    steps = 20_000
    at = phase + (np.arange(steps) + 0.5) / steps * cycles
    counted = np.mean(at % 1.0 < duty)
    # Every edge of the gate in the window may have an error of one step.
    assert gate_share(phase, cycles, duty) == pytest.approx(counted, abs=(2 * cycles + 3) / steps)


def test_pwm_is_seen_by_short_exposures_only():
    lamps = Lamps(pwm_hz=1000.0, pwm_duty=0.4)

    def draws(exposure_us):
        return np.array([lamps.factor(0, 0, exposure_us, (1, i)) for i in range(3000)])

    # A tenth of a cycle: all or nothing except at edges; 10.05 cycles: a little; integer: none.
    short, long, whole = draws(100.0), draws(10_050.0), draws(10_000.0)
    assert short.min() == 0.0
    assert short.max() == pytest.approx(2.5)
    np.testing.assert_allclose(whole, 1.0, rtol=1e-12)
    # With a random phase, the mean is the intensity. Edges share a window of w cycles so that
    # the variance of the all-or-nothing share is (d (1 - d) - w / 3) / d^2.
    variance = (0.4 * 0.6 - 0.1 / 3) / 0.16
    assert short.var() == pytest.approx(variance, rel=0.1)
    assert short.mean() == pytest.approx(1.0, abs=5 * np.sqrt(variance / 3000))
    assert 0 < long.std() < 0.01


def test_only_dead_leds_give_no_light():
    lamps = Lamps(dead=(2, 5), flicker=0.01)
    assert lamps.factor(2, 0, 10.0, (0,)) == 0.0
    assert lamps.factor(3, 0, 10.0, (0,)) > 0.9


SIZE = (3, 5)
SENSOR = NoiseModel(1.0, 0.0, 20.0, 16)


def frames(tmp_path, shots, **options):
    """Return grey values above black of (LED, exposure) shots, one electron per grey value."""
    writer = BenchWriter(tmp_path / "bench.state")
    camera = VirtualCamera(
        lambda led: np.full(SIZE, 0.5 if led is None else 4.0, np.float32),
        **grouped(
            size=SIZE,
            bench=BenchState(tmp_path / "bench.state"),
            noise=SENSOR,
            noisy=False,
            realtime=False,
            **options,
        ),
    )
    camera.arm()
    taken = []
    for led, exposure_us in shots:
        camera.configure(exposure_us=exposure_us)
        if led is not None:
            now = time.monotonic_ns()
            writer.light(led, now, now + 60 * S)
        taken.append(float(camera.fetch(camera.trigger(), 5.0).pixels[0, 0]) - 20)
        writer.put_out(time.monotonic_ns())
    camera.close()
    writer.close()
    return np.array(taken)


def test_lamps_do_not_change_the_ambient_light(tmp_path):
    shots = [(0, 8000), (1, 8000), (None, 8000)]
    lit = frames(tmp_path, shots, lamps=Lamps(dead=(1,)))
    np.testing.assert_array_equal(lit, [36_000, 4000, 4000])


def test_the_clock_of_warm_up_is_the_exposed_time(tmp_path):
    shots = [(0, 10_000)] * 4 + [(None, 10_000)]
    lamps = Lamps(warm_up=0.25, warm_up_s=0.02)
    seen = frames(tmp_path, shots, lamps=lamps)
    start = np.arange(4) * 0.5
    cold = np.exp(-start) * (1 - np.exp(-0.5)) / 0.5
    np.testing.assert_allclose(seen, [*(5000 + 40_000 * (1 + 0.25 * cold)), 5000], atol=0.51)


def test_flicker_and_pwm_do_not_depend_on_the_order_of_shots(tmp_path):
    shots = [(0, 700), (1, 700), (2, 900), (0, 700)]
    options = {"lamps": Lamps(flicker=0.05, pwm_hz=500.0, pwm_duty=0.5), "seed": 3}
    one = frames(tmp_path, shots, **options)
    other = frames(tmp_path, shots[2::-1] + shots[3:], **options)
    np.testing.assert_array_equal(other, [*one[2::-1], one[3]])
    assert len(set(one)) == len(one)
    assert not np.array_equal(one, frames(tmp_path, shots, **{**options, "seed": 4}))


def test_twice_the_exposure_is_twice_the_signal(tmp_path):
    """To a thousandth, after warm-up and with an integer number of PWM cycles."""
    lamps = Lamps(pwm_hz=1000.0, pwm_duty=0.3)
    exposures = [1000, 2000, 4000, 8000]
    seen = frames(tmp_path, [(0, e) for e in exposures], lamps=lamps)
    np.testing.assert_allclose(seen[1:] / seen[:-1], 2.0, rtol=1e-3)
