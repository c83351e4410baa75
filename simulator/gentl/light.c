#include "light.h"

static int64_t overlap_ns(const struct lit *period, int64_t start_ns, int64_t end_ns)
{
    const int64_t from = period->start_ns > start_ns ? period->start_ns : start_ns;
    const int64_t to = period->end_ns < end_ns ? period->end_ns : end_ns;
    return to > from ? (to - from) * (BENCH_FULL_LEVEL - period->dimming) / BENCH_FULL_LEVEL : 0;
}

bool light_see(struct light *light, int64_t start_ns, int64_t exposure_ns, int64_t rows_ns)
{
    light->start_ns = start_ns;
    light->exposure_ns = exposure_ns;
    light->led = -1;
    light->leds = 0;
    light->periods = bench_lit(start_ns, start_ns + exposure_ns + rows_ns, light->lit);
    for (int p = 0; p < light->periods; p++) {
        const struct lit *period = &light->lit[p];
        if (light->led < 0 && period->start_ns <= start_ns && start_ns < period->end_ns)
            light->led = period->led;
        int n = 0;
        while (n < light->leds && light->which[n] != period->led)
            n++;
        light->which[n] = period->led;
        light->leds += n == light->leds;
    }
    return light->periods >= 0;
}

int64_t light_lit_ns(const struct light *light, int32_t led, int64_t row_ns)
{
    const int64_t start_ns = light->start_ns + row_ns, end_ns = start_ns + light->exposure_ns;
    int64_t lit_ns = 0;
    for (int p = 0; p < light->periods; p++)
        if (light->lit[p].led == led)
            lit_ns += overlap_ns(&light->lit[p], start_ns, end_ns);
    return lit_ns;
}

float light_amount_us(const struct light *light, const struct control *camera, int n,
                      int64_t row_ns)
{
    const int32_t led = light->which[n];
    const double exposure_us = (double)light->exposure_ns / 1000;
    const double lit_us = exposure_us * (double)light_lit_ns(light, led, row_ns) /
                          (double)light->exposure_ns;
    if (lit_us == 0)
        return 0;
    return (float)(lit_us *
                   lamps_factor(camera, led, light->lamps_ns, lit_us, light->luck[n], row_ns));
}
