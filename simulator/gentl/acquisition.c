#include "acquisition.h"

#include <math.h>
#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>
#include <string.h>

#include "answers.h"
#include "bench.h"
#include "clock.h"
#include "delivery.h"
#include "fault.h"
#include "nodes.h"
#include "picture.h"
#include "stream.h"

/* Maximum number of exposures whose frames have not been delivered, the camera's memory. It is the
 * length of the ring of pulses, so that threads that wait for a busy host miss no pulse. */
#define UNDER_WAY BENCH_PULSES
#define POLL_NS 200000

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t wake;
static pthread_once_t once = PTHREAD_ONCE_INIT;

static struct control *control;
static uint32_t unplugs; /* counter at the time of opening */
static pthread_t trigger_thread, frame_thread;
static bool acquiring;
/* Also read without the lock, while a frame is composed. */
static atomic_bool quit;
static _Atomic uint64_t runs; /* number of starts and stops; frames of earlier runs are dropped */
static uint64_t next_block, frames_left;
static int64_t armed_ns, lamps_ns, last_start_ns, last_end_ns;
static uint64_t next_pulse;

static struct job {
    struct shot shot;
    struct pixel_format format;
    struct fault fault;
    uint64_t run;
    int64_t out_ns; /* end of the readout */
} jobs[UNDER_WAY];
static uint64_t jobs_in, jobs_out;

static void init(void) { condition_init(&wake); }
void device_lock(void) { pthread_mutex_lock(&lock); }
void device_unlock(void) { pthread_mutex_unlock(&lock); }
void acquisition_notice(void) { pthread_cond_broadcast(&wake); }

bool acquisition_alive(void)
{
    return __atomic_load_n(&control->plugged, __ATOMIC_ACQUIRE) &&
           __atomic_load_n(&control->unplugs, __ATOMIC_ACQUIRE) == unplugs;
}

void acquisition_start(void)
{
    if (acquiring)
        return;
    acquiring = true;
    runs++;
    next_block = control->block_base;
    armed_ns = now_ns();
    last_start_ns = last_end_ns = INT64_MIN / 2;
    const uint64_t pulses = bench_pulses();
    next_pulse = pulses > BENCH_PULSES ? pulses - BENCH_PULSES : 0;
    frames_left = UINT64_MAX;
    if (node_integer(ACQUISITION_MODE) != MODE_CONTINUOUS)
        frames_left = node_integer(ACQUISITION_MODE) == MODE_SINGLE
                          ? 1
                          : (uint64_t)node_integer(ACQUISITION_FRAME_COUNT);
}

void acquisition_stop(void)
{
    runs += acquiring;
    acquiring = false;
}

static double least_period_us(void)
{
    const double wanted = node_integer(FRAME_RATE_ENABLE) ? 1e6 / node_float(FRAME_RATE) : 0;
    return fmax(wanted, control->frame_period_us);
}

/* The earliest time at which an exposure of this length may begin. */
static int64_t earliest_ns(int64_t exposure_ns)
{
    const int64_t readout_ns = llrint(control->readout_us * 1000);
    const int64_t by_period = last_start_ns + llrint(least_period_us() * 1000);
    /* A row is read when its exposure ends; only one row is read at a time. */
    const int64_t by_readout = last_end_ns + readout_ns - exposure_ns;
    int64_t earliest = by_period > last_end_ns ? by_period : last_end_ns;
    return by_readout > earliest ? by_readout : earliest;
}

static void expose(int64_t trigger_ns)
{
    const int64_t exposure_ns = llrint(node_float(EXPOSURE_TIME)) * 1000;
    const int64_t start_ns = trigger_ns + llrint(node_float(TRIGGER_DELAY) * 1000);
    if (frames_left == 0 || start_ns < earliest_ns(exposure_ns) ||
        jobs_in - jobs_out == UNDER_WAY) {
        control->missed++;
        return;
    }
    const struct fault fault = fault_take(control, (int64_t)control->exposures);
    if (fault.kind == FAULT_MISSED) {
        control->missed++;
        return;
    }
    if (fault.kind == FAULT_UNPLUG) {
        control->plugged = 0;
        control->unplugs++;
        acquisition_stop();
        return;
    }
    const int64_t readout_ns = llrint(control->readout_us * 1000);
    struct job *job = &jobs[jobs_in++ % UNDER_WAY];
    *job = (struct job){
        .shot = {.block = next_block++, .start_ns = start_ns, .exposure_ns = exposure_ns,
                 .lamps_ns = lamps_ns, .gain_db = node_float(GAIN),
                 .black_dn = node_float(BLACK_LEVEL),
                 .gamma = node_integer(GAMMA_ENABLE) ? node_float(GAMMA) : 1,
                 .balance_white = node_integer(BALANCE_WHITE_AUTO),
                 .x = (uint32_t)node_integer(OFFSET_X), .y = (uint32_t)node_integer(OFFSET_Y),
                 .width = (uint32_t)node_integer(WIDTH), .height = (uint32_t)node_integer(HEIGHT)},
        .format = node_pixel_format(),
        .fault = fault,
        .run = runs,
        .out_ns = start_ns + exposure_ns + readout_ns,
    };
    control->exposures++;
    frames_left -= frames_left != UINT64_MAX;
    lamps_ns += exposure_ns;
    last_start_ns = start_ns;
    last_end_ns = start_ns + exposure_ns;
    bench_record_exposure(start_ns, control->rolling ? job->out_ns : last_end_ns);
    pthread_cond_broadcast(&wake);
}

GC_ERROR acquisition_software_trigger(void)
{
    if (!node_integer(TRIGGER_MODE) || node_integer(TRIGGER_SOURCE) != SOURCE_SOFTWARE)
        return fail(GC_ERR_ACCESS_DENIED,
                    "TriggerSoftware requires TriggerMode On and TriggerSource Software");
    if (acquiring)
        expose(now_ns());
    else
        control->missed++;
    return GC_ERR_SUCCESS;
}

/* Expose at new pulses of the trigger line; returns the time of the next check. */
static int64_t watch_line(void)
{
    const uint64_t pulses = bench_pulses();
    const int64_t shift = node_integer(TRIGGER_ACTIVATION) == FALLING_EDGE ? BENCH_PULSE_NS : 0;
    for (; next_pulse < pulses; next_pulse++) {
        int64_t at = bench_pulse(next_pulse);
        if (at == BENCH_WITHDRAWN)
            continue;
        const int64_t now = now_ns();
        /* Also for BENCH_NOT_YET, to which adding a value would overflow. */
        if (at > now - shift)
            return at - now < POLL_NS - shift ? at + shift : now + POLL_NS;
        at += shift;
        if (at >= armed_ns)
            expose(at);
    }
    return now_ns() + POLL_NS;
}

/* Expose without triggers; returns the time of the next exposure. */
static int64_t run_free(void)
{
    const int64_t exposure_ns = llrint(node_float(EXPOSURE_TIME)) * 1000;
    const int64_t due = earliest_ns(exposure_ns), now = now_ns();
    if (frames_left == 0 || jobs_in - jobs_out == UNDER_WAY)
        return now + 1000000;
    if (due > now)
        return due;
    expose(now - due < 1000000 ? due : now);
    return now;
}

static void *watch_triggers(void *unused)
{
    (void)unused;
    pthread_mutex_lock(&lock);
    while (!quit) {
        if (acquiring && !acquisition_alive())
            acquisition_stop();
        if (acquiring && !node_integer(TRIGGER_MODE))
            wait_until(&wake, &lock, run_free());
        else if (acquiring && node_integer(TRIGGER_SOURCE) == SOURCE_LINE0)
            wait_until(&wake, &lock, watch_line());
        else
            pthread_cond_wait(&wake, &lock);
    }
    pthread_mutex_unlock(&lock);
    return unused;
}

/* Whether the frame in progress is no longer needed. */
static bool give_up(void)
{
    return quit || !acquisition_alive() || jobs[jobs_out % UNDER_WAY].run != runs;
}

static void *put_frames_out(void *unused)
{
    (void)unused;
    pthread_mutex_lock(&lock);
    while (!quit) {
        if (jobs_in == jobs_out) {
            pthread_cond_wait(&wake, &lock);
            continue;
        }
        struct job *job = &jobs[jobs_out % UNDER_WAY];
        const int64_t due = job->out_ns + (job->fault.kind == FAULT_LATE ? job->fault.late_ns : 0);
        if (!give_up() && now_ns() < due) {
            wait_until(&wake, &lock, due);
            continue;
        }
        pthread_mutex_unlock(&lock);
        const bool composed = job->fault.kind != FAULT_LOST && !give_up() &&
                              stream_awaits(job->fault.kind == FAULT_UNDERRUN) &&
                              picture_compose(&job->shot, give_up);
        const int delivered = composed && !give_up()
                                  ? deliver(&job->shot, &job->format, job->fault.kind,
                                            (int)control->bit_depth)
                                  : 0;
        pthread_mutex_lock(&lock);
        control->delivered += (uint64_t)delivered;
        control->dropped += !delivered;
        if (composed)
            adjust_automatics(&job->shot, control);
        jobs_out++;
    }
    pthread_mutex_unlock(&lock);
    return unused;
}

GC_ERROR acquisition_open(struct control *camera, const struct files *files)
{
    pthread_once(&once, init);
    control = camera;
    unplugs = camera->unplugs;
    quit = acquiring = false;
    jobs_in = jobs_out = 0;
    lamps_ns = 0;
    if (!picture_open(camera, files)) {
        picture_close();
        return fail(GC_ERR_OUT_OF_MEMORY, "not enough memory for frames");
    }
    /* The threads of the host handle signals. */
    sigset_t all, before;
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &before);
    const int first = pthread_create(&trigger_thread, NULL, watch_triggers, NULL);
    const int second = first ? first : pthread_create(&frame_thread, NULL, put_frames_out, NULL);
    pthread_sigmask(SIG_SETMASK, &before, NULL);
    if (!second)
        return GC_ERR_SUCCESS;
    if (!first) {
        device_lock();
        quit = true;
        acquisition_notice();
        device_unlock();
        pthread_join(trigger_thread, NULL);
    }
    picture_close();
    return fail(GC_ERR_RESOURCE_EXHAUSTED, "a thread cannot be started (%s)", strerror(second));
}

void acquisition_close(void)
{
    device_lock();
    acquisition_stop();
    quit = true;
    acquisition_notice();
    device_unlock();
    pthread_join(trigger_thread, NULL);
    pthread_join(frame_thread, NULL);
    picture_close();
}
