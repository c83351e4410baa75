/* Light over time: `simulator/_scene/lamps.py` in C. Change both. */
#ifndef LAMPS_H
#define LAMPS_H

#include "control.h"

/* The random numbers that a shot has for one LED. */
struct lamp_luck {
    double flicker; /* standard normal */
    double phase;   /* of the PWM, cycles */
};
/* `shot` is the stream of the shot's key. */
struct lamp_luck lamps_draw(uint64_t shot, int32_t led);

/* The mean light of an LED during an exposure, relative to its intensity. `row_ns` later than the
 * first row of the shot is the PWM that much further. */
double lamps_factor(const struct control *camera, int32_t led, int64_t start_ns, double lit_us,
                    struct lamp_luck luck, int64_t row_ns);

#endif
