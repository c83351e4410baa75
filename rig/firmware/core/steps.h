// The steps of a sequence, and the record of each step.
#ifndef SGP_STEPS_H
#define SGP_STEPS_H

#include <stdint.h>

#include "board.h"

const uint8_t NO_LED = 63;

// Packed: a small board has 2048 bytes for everything.
struct __attribute__((packed)) Step {
    uint32_t hold_us : 26;  // 0: not loaded
    uint32_t led : 6;       // or NO_LED
    uint32_t settle_us : 20;
    uint32_t gap_us : 20;
};

// State of the exposure-active input while the LED was on.
enum Seen : uint8_t { NEVER, ROSE, STILL_UP };

// Record of one LED from on to off.
struct Burn {
    uint32_t lit_us : 26;
    uint32_t led : 6;
    uint32_t active_us : 30;
    uint32_t seen : 2;
};

struct Record {
    uint32_t trigger_us;  // since the start of the sequence
    Burn burn;
};

extern Step steps[BOARD_STEPS];
extern Record records[BOARD_STEPS];

#endif
