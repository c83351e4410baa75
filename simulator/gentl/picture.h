/* The picture of one exposure: grey values from light, lamps and sensor. */
#ifndef PICTURE_H
#define PICTURE_H

#include <stdbool.h>
#include <stdint.h>

#include "control.h"

/* All values that determine a frame. */
struct shot {
    uint64_t block;
    int64_t start_ns;
    int64_t exposure_ns;
    int64_t lamps_ns; /* start on the lamps' clock: the sum of all earlier exposure times */
    double gain_db;
    double black_dn;
    double gamma;         /* 1 for linear */
    bool balance_white;
    uint32_t x, y, width, height;
};

/* Allocate memory for frames of this camera; returns false if there is not enough memory. */
bool picture_open(const struct control *camera, const struct files *files);
void picture_close(void);

/* Compose a frame, whose rows picture_row then returns. Returns false if it is unknown which LEDs
 * were on, or if `give_up` returned true. */
bool picture_compose(const struct shot *shot, bool (*give_up)(void));
const uint16_t *picture_row(uint32_t row);

#endif
