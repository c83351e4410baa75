/* What the camera sees in one exposure: grey values from light, lamps and sensor. */
#ifndef PICTURE_H
#define PICTURE_H

#include <stdbool.h>
#include <stdint.h>

#include "control.h"

/* All that decides a frame. */
struct shot {
    uint64_t block;
    int64_t start_ns;
    int64_t exposure_ns;
    int64_t lamps_ns; /* start on the lamps' clock: the sum of all exposures before */
    double gain_db;
    double black_dn;
    double gamma;         /* 1 for linear */
    bool balance_white;
    uint32_t x, y, width, height;
};

/* Memory for frames of this camera; false where there is none. */
bool picture_open(const struct control *camera, const struct files *files);
void picture_close(void);

/* Compose a frame; rows are then asked for one by one. False where it cannot be known what burned,
 * or where `give_up` said so. */
bool picture_compose(const struct shot *shot, bool (*give_up)(void));
const uint16_t *picture_row(uint32_t row);

#endif
