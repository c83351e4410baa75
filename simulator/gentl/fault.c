#include "fault.h"

struct fault fault_take(struct control *camera, int64_t exposure)
{
    for (int i = 0; i < CONTROL_FAULTS; i++) {
        struct fault *fault = &camera->faults[i];
        if (!__atomic_load_n(&fault->armed, __ATOMIC_ACQUIRE) ||
            (fault->at != -1 && fault->at != exposure))
            continue;
        const struct fault taken = *fault;
        __atomic_store_n(&fault->armed, 0, __ATOMIC_RELEASE);
        return taken;
    }
    return (struct fault){.kind = FAULT_NONE};
}
