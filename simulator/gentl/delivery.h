/* From a composed picture to the client's buffer. */
#ifndef DELIVERY_H
#define DELIVERY_H

#include "control.h"
#include "picture.h"
#include "pixels.h"

/* Pack the picture into the client's next buffer. Returns how many buffers went out: none where
 * none was queued. */
int deliver(const struct shot *shot, const struct pixel_format *format, uint32_t fault,
            int sample_bits);
/* Exposure and gain of the next frame, where automatics are on. */
void adjust_automatics(const struct shot *shot, const struct control *camera);

#endif
