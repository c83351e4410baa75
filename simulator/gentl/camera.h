/* The camera as a device: open it, read and write its registers. */
#ifndef CAMERA_H
#define CAMERA_H

#include <stdbool.h>

#include "control.h"
#include "gentl.h"

bool camera_plugged(void);
/* The serial number, which is also the device's id. */
const char *camera_serial(void);
GC_ERROR camera_open(void);
void camera_close(void);
/* Close the camera, and read the control file again at the next access. */
void camera_forget(void);
size_t camera_payload(void);
/* Maximum number of buffers of the open camera's stream; 0: limit of the stream. */
uint32_t camera_most_buffers(void);
GC_ERROR camera_read(uint64_t address, void *to, size_t size);
GC_ERROR camera_write(uint64_t address, const void *from, size_t size);

#endif
