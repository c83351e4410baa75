/* The bench state: the light and the trigger pulses of the board, and the exposures told to it.
 * The file's layout is that of `simulator/_bench_state.py`. */
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
    int32_t dimming; /* its light is 1 - dimming / 4095 of the full */
    int64_t start_ns, end_ns;
};
#define BENCH_FULL_LEVEL 4095

/* An empty path: nothing ever burns and no pulse ever comes. */
GC_ERROR bench_open(const char *path);
void bench_close(void);
/* Copy the periods that touch a window, oldest first. Returns how many; -1 where the ring may have
 * forgotten some. */
int bench_lit(int64_t start_ns, int64_t end_ns, struct lit lit[BENCH_LIT]);
/* How many trigger pulses have been announced so far. */
uint64_t bench_pulses(void);
/* When a pulse comes or came; BENCH_WITHDRAWN for one that does not or is forgotten, and
 * BENCH_NOT_YET while it is being written. */
int64_t bench_pulse(uint64_t number);
/* Tell the board when the camera exposes. */
void bench_tell_exposure(int64_t start_ns, int64_t end_ns);

#endif
