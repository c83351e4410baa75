/* Acquisition: from triggers to frames. One lock protects it and the registers. */
#ifndef ACQUISITION_H
#define ACQUISITION_H

#include "control.h"
#include "gentl.h"

void device_lock(void);
void device_unlock(void);

GC_ERROR acquisition_open(struct control *camera, const struct files *files);
void acquisition_close(void);
/* Whether this camera has not been unplugged since it was opened. */
bool acquisition_alive(void);

/* With the lock held: */
void acquisition_start(void);
void acquisition_stop(void);
GC_ERROR acquisition_software_trigger(void);
/* Wake the threads: registers have changed. */
void acquisition_notice(void);

#endif
