/* What light falls on each row in one exposure, by the bench state and the lamps. */
#ifndef LIGHT_H
#define LIGHT_H

#include "bench.h"
#include "lamps.h"

struct light {
    int64_t start_ns, exposure_ns, lamps_ns;
    int32_t led; /* that burned at the start, -1 for none */
    int periods, leds;
    struct lit lit[BENCH_LIT];
    int32_t which[BENCH_LIT]; /* LEDs that burned, in the order in which they began */
    struct lamp_luck luck[BENCH_LIT];
};

/* Ask the bench what burned up to the end of the last row; false where it has forgotten. */
bool light_see(struct light *light, int64_t start_ns, int64_t exposure_ns, int64_t rows_ns);
/* For how long an LED burned while the row was exposed, at full brightness. */
int64_t light_lit_ns(const struct light *light, int32_t led, int64_t row_ns);
/* The same by the n-th LED in microseconds, times what its lamp gave. */
float light_amount_us(const struct light *light, const struct control *camera, int n,
                      int64_t row_ns);

#endif
