/* Light on each row during one exposure, from the bench state and the lamps. */
#ifndef LIGHT_H
#define LIGHT_H

#include "bench.h"
#include "lamps.h"

struct light {
    int64_t start_ns, exposure_ns, lamps_ns;
    int32_t led; /* LED that was on at the start, or -1 */
    int periods, leds;
    struct lit lit[BENCH_LIT];
    int32_t which[BENCH_LIT]; /* LEDs that were on, in the order in which they turned on */
    struct lamp_luck luck[BENCH_LIT];
};

/* Read from the bench state which LEDs were on until the end of the last row; returns false if the
 * ring no longer contains all periods. */
bool light_see(struct light *light, int64_t start_ns, int64_t exposure_ns, int64_t rows_ns);
/* Time that an LED was on while the row was exposed, at full brightness. */
int64_t light_lit_ns(const struct light *light, int32_t led, int64_t row_ns);
/* The same for the n-th LED in microseconds, times its factor from lamps_factor. */
float light_amount_us(const struct light *light, const struct control *camera, int n,
                      int64_t row_ns);

#endif
