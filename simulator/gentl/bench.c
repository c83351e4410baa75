#include "bench.h"

#include <errno.h>
#include <fcntl.h>
#include <stdbool.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "answers.h"

#define EXPOSURES 64

struct bench {
    char magic[8];
    uint32_t version;
    uint32_t lit_length;
    uint64_t board_changes; /* odd while the board writes */
    uint64_t lit_count;
    uint64_t pulse_count;
    uint32_t pulse_length;
    uint32_t exposure_length;
    uint64_t camera_changes; /* odd while the camera writes */
    uint64_t exposure_count;
    struct lit lit[BENCH_LIT];
    struct {
        int64_t number, time_ns;
    } pulses[BENCH_PULSES];
    struct {
        int64_t start_ns, end_ns;
    } exposures[EXPOSURES];
};

_Static_assert(offsetof(struct bench, lit) == 64, "the header has 64 bytes");

static struct bench *bench;

GC_ERROR bench_open(const char *path)
{
    if (!path[0])
        return GC_ERR_SUCCESS;
    struct stat about;
    const int fd = open(path, O_RDWR | O_CLOEXEC);
    if (fd < 0 || fstat(fd, &about) != 0) {
        const GC_ERROR result =
            fail(GC_ERR_IO, "%s: the bench state cannot be opened (%s); is the virtual board running?",
                 path, strerror(errno));
        if (fd >= 0)
            close(fd);
        return result;
    }
    void *at = MAP_FAILED;
    if ((size_t)about.st_size >= sizeof *bench)
        at = mmap(NULL, sizeof *bench, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    close(fd);
    if (at == MAP_FAILED)
        return fail(GC_ERR_IO, "%s: not a bench state: %lld bytes", path,
                    (long long)about.st_size);
    bench = at;
    if (memcmp(bench->magic, "SGPBENCH", 8) == 0 && bench->version == 2 &&
        bench->lit_length == BENCH_LIT && bench->pulse_length == BENCH_PULSES &&
        bench->exposure_length == EXPOSURES)
        return GC_ERR_SUCCESS;
    bench_close();
    return fail(GC_ERR_IO, "%s: not a bench state of version 2", path);
}

void bench_close(void)
{
    if (bench)
        munmap(bench, sizeof *bench);
    bench = NULL;
}

/* Copy the bench state while the board is not writing. If the board died while it wrote, its change
 * counter stays odd: after about a tenth of a second, the state is copied as it is, and later
 * copies do not wait. */
static struct bench copied(void)
{
    static _Thread_local uint64_t given_up_on;
    struct bench copy;
    uint64_t before;
    for (int attempt = 0;; attempt++) {
        before = __atomic_load_n(&bench->board_changes, __ATOMIC_ACQUIRE);
        memcpy(&copy, bench, sizeof copy);
        __atomic_thread_fence(__ATOMIC_ACQUIRE);
        if (before % 2 == 0 && __atomic_load_n(&bench->board_changes, __ATOMIC_RELAXED) == before)
            return copy;
        if (attempt >= 1000 || (before % 2 && before == given_up_on))
            break;
        nanosleep(&(struct timespec){0, 50000}, NULL);
    }
    given_up_on = before;
    return copy;
}

int bench_lit(int64_t start_ns, int64_t end_ns, struct lit lit[BENCH_LIT])
{
    if (!bench)
        return 0;
    const struct bench copy = copied();
    const uint64_t first = copy.lit_count > BENCH_LIT ? copy.lit_count - BENCH_LIT : 0;
    if (first && copy.lit[first % BENCH_LIT].start_ns > start_ns)
        return -1;
    int count = 0;
    for (uint64_t k = first; k < copy.lit_count; k++) {
        const struct lit *period = &copy.lit[k % BENCH_LIT];
        if (period->start_ns < end_ns && period->end_ns > start_ns)
            lit[count++] = *period;
    }
    return count;
}

uint64_t bench_pulses(void)
{
    return bench ? __atomic_load_n(&bench->pulse_count, __ATOMIC_ACQUIRE) : 0;
}

int64_t bench_pulse(uint64_t number)
{
    if (!bench)
        return BENCH_WITHDRAWN;
    const struct bench copy = copied();
    const uint64_t slot = number % BENCH_PULSES;
    const int64_t written = copy.pulses[slot].number;
    if (copy.pulse_count <= number || written < (int64_t)number)
        return BENCH_NOT_YET;
    return written == (int64_t)number ? copy.pulses[slot].time_ns : BENCH_WITHDRAWN;
}

void bench_record_exposure(int64_t start_ns, int64_t end_ns)
{
    if (!bench)
        return;
    const uint64_t changes = bench->camera_changes, slot = bench->exposure_count % EXPOSURES;
    __atomic_store_n(&bench->camera_changes, changes | 1, __ATOMIC_RELEASE);
    __atomic_thread_fence(__ATOMIC_SEQ_CST);
    bench->exposures[slot].start_ns = start_ns;
    bench->exposures[slot].end_ns = end_ns;
    bench->exposure_count++;
    __atomic_store_n(&bench->camera_changes, (changes | 1) + 1, __ATOMIC_RELEASE);
}
