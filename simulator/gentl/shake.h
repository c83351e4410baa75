/* A camera that trembles: `simulator/_camera/shake.py` in C. Change both. */
#ifndef SHAKE_H
#define SHAKE_H

#include <stdbool.h>
#include <stdint.h>

/* Shift an image right and down by parts of a pixel. `between` has room for as many values. */
void shake_shift(float *image, float *between, uint32_t width, uint32_t height, double right,
                 double down, bool mosaic);
/* Where the image lies in a shot. */
void shake_draw(uint64_t shot, double sigma_px, double *right, double *down);

#endif
