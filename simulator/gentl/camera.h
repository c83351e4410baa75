/* The camera as a device: opened, asked and told through registers. */
#ifndef CAMERA_H
#define CAMERA_H

#include <stdbool.h>

#include "control.h"
#include "gentl.h"

bool camera_plugged(void);
/* The serial number, which is the device's name too. */
const char *camera_serial(void);
GC_ERROR camera_open(void);
void camera_close(void);
/* Close, and read the control file afresh when next asked. */
void camera_forget(void);
size_t camera_payload(void);
/* How many buffers its stream takes; 0 for no limit of its own. Of an open camera. */
uint32_t camera_most_buffers(void);
GC_ERROR camera_read(uint64_t address, void *to, size_t size);
GC_ERROR camera_write(uint64_t address, const void *from, size_t size);

#endif
