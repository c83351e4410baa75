/* Camera shake: `simulator/camera/virtual_sensor.py` in C. Change both together. */
#ifndef SHAKE_H
#define SHAKE_H

#include <stdbool.h>
#include <stdint.h>

/* Shift an image right and down by fractions of a pixel. `between` is scratch memory of the same
 * size. */
void shake_shift(float *image, float *between, uint32_t width, uint32_t height, double right,
                 double down, bool mosaic);
/* Draw the shift of the image in a shot. */
void shake_draw(uint64_t shot, double sigma_px, double *right, double *down);

#endif
