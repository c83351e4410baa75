/* The bench state: light and trigger pulses of the board, and exposures of the camera.
 * The layout of the file is that of `simulator/bench/state.py`. */
#ifndef BENCH_H
#define BENCH_H

#include <stdint.h>

#include "gentl.h"

#define BENCH_LIT 64
#define BENCH_PULSES 64
#define BENCH_WITHDRAWN INT64_MAX
#define BENCH_NOT_YET (INT64_MAX - 1)
#define BENCH_PULSE_NS 200000

struct lit {
    int32_t led;
    int32_t dimming; /* the light is 1 - dimming / 4095 of full brightness */
    int64_t start_ns, end_ns;
};
#define BENCH_FULL_LEVEL 4095

/* With an empty path, all LEDs are always off and there are no pulses. */
GC_ERROR bench_open(const char *path);
void bench_close(void);
/* Copy the periods that overlap a window, oldest first. Returns their number, or -1 if the ring may
 * no longer contain some of them. */
int bench_lit(int64_t start_ns, int64_t end_ns, struct lit lit[BENCH_LIT]);
/* Number of trigger pulses announced so far. */
uint64_t bench_pulses(void);
/* Time of a pulse in the past or future; BENCH_WITHDRAWN if it was cancelled or is no longer in the
 * ring, BENCH_NOT_YET while it is being written. */
int64_t bench_pulse(uint64_t number);
/* Record an exposure for the board. */
void bench_record_exposure(int64_t start_ns, int64_t end_ns);

#endif
