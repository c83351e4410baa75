/* Number of equal shots before a shot. */
#ifndef REPEATS_H
#define REPEATS_H

#include <stdint.h>

/* Shots are equal if these values are equal. */
struct shot_kind {
    uint64_t led; /* LED that was on at the start, plus 1; 0 without LED */
    uint64_t exposure_ns;
    uint64_t gain_mdb;
};

void repeats_forget(void);
/* Count this shot and return the number of equal shots before it. */
uint64_t repeats_count(const struct shot_kind *kind);

#endif
