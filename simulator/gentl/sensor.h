/* The sensor: `simulator/_camera/sensor.py` in C, to the same random numbers. Change both. */
#ifndef SENSOR_H
#define SENSOR_H

#include <stdbool.h>
#include <stdint.h>

#include "control.h"

/* What is the same for all pixels of a frame. */
struct sensor {
    float efficiency, dark_e, exposure_s, full_well_e, read_noise_e;
    float dn_per_electron, black_dn, end_dn;
    bool noisy;
    uint64_t state; /* of the shot's random numbers */
};

struct sensor sensor_for(const struct control *camera, int64_t exposure_ns, double gain_db,
                         double black_dn, uint64_t state);

/* A run of pixels: their photons, and their places in the maps of the fixed pattern (NULL where
 * all pixels are alike). `first` is the place of the first one on the sensor. */
struct pixel_run {
    const float *photons, *response, *offset, *hot;
    uint64_t first;
    uint32_t count;
};
void sensor_expose(const struct sensor *sensor, const struct pixel_run *run, uint16_t *grey);

#endif
