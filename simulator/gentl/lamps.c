#include "lamps.h"

#include <math.h>

#include "dice.h"

#define TAG 0x1A3B

struct lamp_luck lamps_draw(uint64_t shot, int32_t led)
{
    const uint64_t state = dice_stream(shot, (const uint64_t[]){(uint64_t)led, TAG}, 2);
    double flicker, unused;
    dice_normal_pair(state, 0, &flicker, &unused);
    return (struct lamp_luck){flicker, dice_uniform(state, 2)};
}

static double open_until(double cycles, double duty)
{
    const double whole = floor(cycles);
    return whole * duty + fmin(cycles - whole, duty);
}

static double gate_share(double phase, double cycles, double duty)
{
    return (open_until(phase + cycles, duty) - open_until(phase, duty)) / cycles;
}

double lamps_factor(const struct control *camera, int32_t led, int64_t start_ns, double lit_us,
                    struct lamp_luck luck, int64_t row_ns)
{
    if (camera->dead[led])
        return 0;
    const double length = lit_us / 1e6 / camera->warm_up_s;
    const double start_s = (double)(start_ns + row_ns) / 1e9;
    double value = 1;
    if (camera->warm_up != 0)
        value += camera->warm_up * exp(-start_s / camera->warm_up_s) * -expm1(-length) / length;
    value *= fmax(0, 1 + camera->flicker * luck.flicker);
    if (camera->pwm_hz > 0) {
        const double phase = luck.phase + fmod((double)row_ns / 1e9 * camera->pwm_hz, 1);
        value *= gate_share(phase, lit_us / 1e6 * camera->pwm_hz, camera->pwm_duty) /
                 camera->pwm_duty;
    }
    return value;
}
