/* Faults that the maker of the camera has asked for. */
#ifndef FAULT_H
#define FAULT_H

#include "control.h"

/* Take the fault that waits for this exposure; its kind is FAULT_NONE where there is none. */
struct fault fault_take(struct control *camera, int64_t exposure);

#endif
