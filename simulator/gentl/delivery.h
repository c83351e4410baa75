/* Delivery of a composed picture to the client's buffer. */
#ifndef DELIVERY_H
#define DELIVERY_H

#include "control.h"
#include "picture.h"
#include "pixels.h"

/* Pack the picture into the client's next buffer. Returns the number of delivered buffers, 0 if no
 * buffer was queued. */
int deliver(const struct shot *shot, const struct pixel_format *format, uint32_t fault,
            int sample_bits);
/* Set exposure time and gain of the next frame if they are automatic. */
void adjust_automatics(const struct shot *shot, const struct control *camera);

#endif
