/* Faults that are set in the control file. */
#ifndef FAULT_H
#define FAULT_H

#include "control.h"

/* Remove and return the fault of this exposure; its kind is FAULT_NONE if there is no fault. */
struct fault fault_take(struct control *camera, int64_t exposure);

#endif
