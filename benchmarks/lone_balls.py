"""A mirror ball without a plane around it: are its lights right, or their errors stated?

Each seed draws a ball on a dark cloth in a cluttered room, and the complete calibration searches
for it. Its line contains the root mean square of the errors of the directions and of their stated
standard deviations, both in degrees, how far the outline is off in centre x, centre y and radius,
and the notices; or the message of the refusal. Lines with `<` are beyond three standard deviations.
With --blur-px, the images are blurred by that much more, as those of a ball that is out of focus.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from drawn_lone_balls import LoneBall, lone_ball
from harness import command_line

from acquisition import Lights, angle_deg
from acquisition.values import led_of
from calibration import EstimateError, calibrate_spheres


def blurred(ball: LoneBall, sigma_px: float) -> LoneBall:
    """Return the recording of a lens that is out of focus; it is not noisier or sharper."""
    white = np.nan_to_num(ball.values, nan=1.0)
    images = [cv2.GaussianBlur(image, (0, 0), sigma_px) for image in white]
    noise = np.random.default_rng(0).normal(size=white.shape) * 0.002
    values = np.where(np.isnan(ball.values), np.nan, np.array(images) + noise)
    return replace(ball, values=values.astype(np.float32))


def judged(ball: LoneBall) -> tuple[float, float, str]:
    """Return error and stated error of the directions in degrees, NaN if refused, and a remark."""
    try:
        result = calibrate_spheres(ball.values)
    except EstimateError as refusal:
        return np.nan, np.nan, f"refused: {refusal}"
    known = [led_of(name) for name in result.lights.ids]
    error_deg = angle_deg(np.asarray(result.lights.unit_directions), ball.directions[known])
    outline = result.spheres[0].outline
    off = np.array([*outline.centre_px, outline.radius_px]) - ball.circle
    codes = [notice.code for notice in result.warnings if notice.code != "highlights-saturated"]
    left = f"{len(known)} of {len(ball.directions)} lights"
    remark = " ".join([f"off {off[0]:+.2f} {off[1]:+.2f} {off[2]:+.2f} px, {left}", *codes])
    return float(np.sqrt(np.mean(error_deg**2))), stated_deg(result.lights), remark


def stated_deg(lights: Lights) -> float:
    """Return the root mean square of the stated errors along one axis in degrees."""
    if lights.errors is None or lights.errors.covariances is None:
        return np.nan
    variances = np.trace(lights.errors.covariances, axis1=1, axis2=2) / 2
    return float(np.degrees(np.sqrt(np.mean(variances))))


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--first", type=int, default=340, help="first seed")
    parser.add_argument("--balls", type=int, default=20, help="number of seeds")
    parser.add_argument("--blur-px", type=float, default=0.0, help="additional blur")
    options = parser.parse_args()
    rows = []
    for seed in range(options.first, options.first + options.balls):
        ball = lone_ball(seed)
        if options.blur_px > 0:
            ball = blurred(ball, options.blur_px)
        error, stated, remark = judged(ball)
        beyond = "<" if error > 3 * stated else " "
        print(
            f"{seed} r{ball.circle[2]:4.0f} px {error:6.2f} {stated:6.2f} {beyond} {remark}",
            flush=True,
        )
        rows.append((error, stated))
    errors, sigmas = np.array([row for row in rows if np.isfinite(row[0])]).reshape(-1, 2).T
    median = np.median(errors) if len(errors) else np.nan
    print(
        f"{len(errors)} calibrated, {len(rows) - len(errors)} refused; median error {median:.2f} "
        f"degrees; {np.sum(errors > 3 * sigmas)} beyond three standard deviations"
    )


if __name__ == "__main__":
    main()
