#include "repeats.h"

#include <stdlib.h>
#include <string.h>

#include "dice.h"

/* Hash table with open addressing: a free entry has the count 0. */
static struct entry {
    struct shot_kind kind;
    uint64_t count;
} *table;
static uint64_t places, used;

void repeats_forget(void)
{
    free(table);
    table = NULL;
    places = used = 0;
}

static struct entry *find(struct entry *in, uint64_t size, const struct shot_kind *kind)
{
    const uint64_t key[] = {kind->led, kind->exposure_ns, kind->gain_mdb};
    uint64_t at = dice_stream(0, key, 3) % size;
    while (in[at].count && memcmp(&in[at].kind, kind, sizeof *kind) != 0)
        at = (at + 1) % size;
    return &in[at];
}

static int grow(void)
{
    const uint64_t size = places ? 2 * places : 256;
    struct entry *bigger = calloc(size, sizeof *bigger);
    if (!bigger)
        return 0;
    for (uint64_t i = 0; i < places; i++)
        if (table[i].count)
            *find(bigger, size, &table[i].kind) = table[i];
    free(table);
    table = bigger;
    places = size;
    return 1;
}

uint64_t repeats_count(const struct shot_kind *kind)
{
    if (2 * used >= places && !grow() && used + 1 >= places)
        return 0;
    struct entry *entry = find(table, places, kind);
    if (!entry->count) {
        entry->kind = *kind;
        used++;
    }
    return entry->count++;
}
