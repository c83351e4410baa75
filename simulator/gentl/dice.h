/* Counter-based random numbers: `simulator/noise/dice.py` in C. Change both together. */
#ifndef DICE_H
#define DICE_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#define TWO_PI 6.283185307179586

/* The 64 random bits at a position of a stream (SplitMix64). */
static inline uint64_t dice_bits(uint64_t state, uint64_t counter)
{
    uint64_t x = state + (counter + 1) * 0x9E3779B97F4A7C15u;
    x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9u;
    x = (x ^ (x >> 27)) * 0x94D049BB133111EBu;
    return x ^ (x >> 31);
}

/* The stream of a key, or of the key of `state` continued by these numbers. */
static inline uint64_t dice_stream(uint64_t state, const uint64_t *key, size_t count)
{
    for (size_t i = 0; i < count; i++)
        state = dice_bits(state, key[i]);
    return state;
}

static inline double dice_uniform(uint64_t state, uint64_t counter)
{
    return ((double)(dice_bits(state, counter) >> 12) + 0.5) * 0x1p-52;
}

static inline void dice_normal_pair(uint64_t state, uint64_t counter, double *first,
                                    double *second)
{
    const double radius = sqrt(-2.0 * log(dice_uniform(state, counter)));
    const double turn = TWO_PI * dice_uniform(state, counter + 1);
    *first = radius * cos(turn);
    *second = radius * sin(turn);
}

#endif
