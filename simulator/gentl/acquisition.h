/* The camera at work: triggers in, frames out. One lock guards it and the registers. */
#ifndef ACQUISITION_H
#define ACQUISITION_H

#include "control.h"
#include "gentl.h"

void device_lock(void);
void device_unlock(void);

GC_ERROR acquisition_open(struct control *camera, const struct files *files);
void acquisition_close(void);
/* Whether this camera is still the one that was opened: not unplugged since. */
bool acquisition_alive(void);

/* With the lock held: */
void acquisition_start(void);
void acquisition_stop(void);
GC_ERROR acquisition_software_trigger(void);
/* Registers have changed: look again. */
void acquisition_notice(void);

#endif
