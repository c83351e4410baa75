/* The sensor: `simulator/camera/sensor.py` in C with the same random numbers. Change both
 * together. */
#ifndef SENSOR_H
#define SENSOR_H

#include <stdbool.h>
#include <stdint.h>

#include "control.h"

/* Values that are the same for all pixels of a frame. */
struct sensor {
    float efficiency, dark_e, exposure_s, full_well_e, read_noise_e;
    float dn_per_electron, black_dn, end_dn;
    bool noisy;
    uint64_t state; /* stream of the shot's random numbers */
};

struct sensor sensor_for(const struct control *camera, int64_t exposure_ns, double gain_db,
                         double black_dn, uint64_t state);

/* A run of pixels: their photons, and pointers to them in the maps of the fixed pattern (NULL if
 * all pixels are alike). `first` is the index of the first pixel on the sensor. */
struct pixel_run {
    const float *photons, *response, *offset, *hot;
    uint64_t first;
    uint32_t count;
};
void sensor_expose(const struct sensor *sensor, const struct pixel_run *run, uint16_t *grey);

#endif
