/* Light over time: `simulator/scene/lamps.py` in C. Change both together. */
#ifndef LAMPS_H
#define LAMPS_H

#include "control.h"

/* Random numbers of a shot for one LED. */
struct lamp_luck {
    double flicker; /* standard normal */
    double phase;   /* of the PWM, cycles */
};
/* `shot` is the random stream of the shot's key. */
struct lamp_luck lamps_draw(uint64_t shot, int32_t led);

/* Mean light of an LED during an exposure, relative to its intensity, for a row that is exposed
 * `row_ns` later than the first row of the shot. */
double lamps_factor(const struct control *camera, int32_t led, int64_t start_ns, double lit_us,
                    struct lamp_luck luck, int64_t row_ns);

#endif
