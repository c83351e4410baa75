#include "develop.h"

#include <math.h>

/* Index of a pixel's filter among the mosaic's 2 x 2 filters: 0 to 3, row by row. */
static int filter_of(const struct shot *shot, uint32_t row, uint32_t column)
{
    return (int)((row + shot->y) % 2 * 2 + (column + shot->x) % 2);
}

/* Scale red and blue to the mean of green. */
static void balance_white(uint16_t *grey, const struct shot *shot, const struct control *camera)
{
    double sums[4] = {0}, gains[4], green = 0;
    uint64_t counts[4] = {0};
    for (uint32_t row = 0; row < shot->height; row++)
        for (uint32_t column = 0; column < shot->width; column++) {
            const int filter = filter_of(shot, row, column);
            sums[filter] += grey[(size_t)row * shot->width + column];
            counts[filter]++;
        }
    for (int i = 0; i < 4; i++) {
        sums[i] = fmax(sums[i] / (double)(counts[i] ? counts[i] : 1) - shot->black_dn, 1);
        green += camera->cfa[i] == 'G' ? sums[i] / 2 : 0;
    }
    for (int i = 0; i < 4; i++)
        gains[i] = camera->cfa[i] == 'G' ? 1 : fmin(green / sums[i], 8);
    const double end = ldexp(1, (int)camera->bit_depth) - 1;
    for (uint32_t row = 0; row < shot->height; row++)
        for (uint32_t column = 0; column < shot->width; column++) {
            uint16_t *at = &grey[(size_t)row * shot->width + column];
            const double value =
                shot->black_dn + (*at - shot->black_dn) * gains[filter_of(shot, row, column)];
            *at = (uint16_t)fmin(fmax(rint(value), 0), end);
        }
}

void develop(uint16_t *grey, const struct shot *shot, const struct control *camera)
{
    if (shot->balance_white && camera->cfa[0])
        balance_white(grey, shot, camera);
    if (shot->gamma == 1)
        return;
    const double end = ldexp(1, (int)camera->bit_depth) - 1;
    for (size_t i = 0; i < (size_t)shot->width * shot->height; i++)
        grey[i] = (uint16_t)rint(end * pow(grey[i] / end, shot->gamma));
}
