/* How many equal shots came before a shot. */
#ifndef REPEATS_H
#define REPEATS_H

#include <stdint.h>

/* What makes shots equal. */
struct shot_kind {
    uint64_t led; /* that burned at the start, plus 1; 0 for none */
    uint64_t exposure_ns;
    uint64_t gain_mdb;
};

void repeats_forget(void);
/* Count this one and return how many came before. */
uint64_t repeats_count(const struct shot_kind *kind);

#endif
