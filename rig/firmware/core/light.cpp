#include "light.h"

#include "board.h"

namespace light {
namespace {

const uint32_t PULSE_US = 200;

// Phase of the current or next light. STILL: nothing is due by the clock.
enum Phase : uint8_t { STILL, DARK, SETTLING, PULSING, HOLDING };

State now_in;
Phase phase;
uint32_t due;  // when the phase ends
uint32_t hold_us;
uint8_t burning;
uint16_t levels[BOARD_LEDS];

Pace pace;
uint8_t count;
uint8_t ended;
bool stopping;  // the watchdog acted: this step is the last
bool shifting;
bool shifted;  // the drivers hold the pattern of the next step
bool flash_over;

uint32_t run_at, lit_at, pulse_at;
Burn burn;

bool up;          // exposure-active input, as last read
bool rose, fell;  // whether it rose and fell since the trigger
uint32_t up_at;

uint32_t heard_at;
uint32_t trip_count;
uint32_t clock_at, clock_ms;
uint32_t pulse_ms, since_us;  // when the last pulse was, and its time since the previous one
bool pulsed;

bool lit() { return phase >= SETTLING; }

bool before(uint32_t now, uint32_t then) { return static_cast<int32_t>(then - now) > 0; }

// Shift the pattern of one LED, or of none, into the drivers. Edges are still served meanwhile.
void shift_in(uint8_t led) {
    shifting = true;
    for (uint8_t channel = BOARD_CHANNELS; channel-- > 0;) {
        board_shift(channel == led ? levels[channel] : 0);
        if (channel % 4 == 0)
            poll();
    }
    shifting = false;
}

void watch_exposure(uint32_t now) {
    if (board_active() == up)
        return;
    up = !up;
    if (up) {
        up_at = now;
        burn.seen = ROSE;
        rose = phase > SETTLING;
        return;
    }
    burn.active_us += now - up_at;
    fell = rose;
    if (fell && now_in == RUN && pace == BY_EXPOSURE) {
        phase = HOLDING;
        due = now;
    }
}

void light_up(uint8_t led, uint32_t settle_us, uint32_t for_us) {
    if (led != NO_LED)
        board_light();
    lit_at = board_now_us();
    burning = led;
    hold_us = for_us;
    phase = SETTLING;
    due = lit_at + settle_us;
    up = board_active();
    up_at = lit_at;
    rose = fell = false;
    burn.led = led;
    burn.lit_us = burn.active_us = 0;
    burn.seen = up ? ROSE : NEVER;
}

void pulse() {
    board_trigger(true);
    const uint32_t now = board_now_us();
    const uint32_t apart_ms = (clock_ms + 1000000000 - pulse_ms) % 1000000000;
    // A little less than nine digits: the two clocks are read one after the other.
    since_us = pulsed && apart_ms < 999000 ? now - pulse_at : NO_PULSE;
    pulse_at = now;
    pulse_ms = clock_ms;
    pulsed = true;
    phase = hold_us > PULSE_US ? PULSING : HOLDING;
    due = pulse_at + (hold_us > PULSE_US ? PULSE_US : hold_us);
}

// Turn the LED off, set the trigger low, and clear the due time.
void put_out() {
    board_dark();
    board_trigger(false);
    const uint32_t now = board_now_us();
    burn.lit_us = now - lit_at;
    if (up) {
        burn.active_us += now - up_at;
        burn.seen = STILL_UP;
    }
    burning = NO_LED;
    phase = STILL;
}

void end_step() {
    records[ended] = Record{pulse_at - run_at, burn};
    const Step &step = steps[ended];
    ended++;
    if (pace == BY_EXPOSURE && !fell)
        now_in = HALT;
    else if (ended == count)
        now_in = IDLE;
    else if (stopping)
        now_in = HALT;
    else {
        phase = DARK;
        due = lit_at + burn.lit_us + step.gap_us;
    }
}

void end_light() {
    put_out();
    if (now_in == RUN) {
        end_step();
        return;
    }
    flash_over = now_in == FLASH;
    now_in = IDLE;
}

void edge() {
    if (phase == HOLDING) {
        end_light();
    } else if (phase == SETTLING) {
        pulse();
    } else if (phase == PULSING) {
        board_trigger(false);
        phase = HOLDING;
        due = pulse_at + hold_us;
    } else if (phase == DARK) {
        shifted = false;
        const Step &step = steps[ended];
        light_up(step.led, step.settle_us, step.hold_us);
    }
}

void edges(uint32_t now) {
    while (phase != STILL && !(phase == DARK && !shifted)) {
        if (before(now, due - BOARD_SPIN_US))
            return;
        // Half of the clock's bits are faster and sufficient: an overdue edge never looks further ahead than this.
        while (static_cast<uint16_t>(due - now - 1) < BOARD_SPIN_US) {
            if (lit())
                watch_exposure(now);
            now = board_now_us();
        }
        edge();
        now = board_now_us();
    }
}

void watchdog() {
    if (board_now_us() - heard_at < WATCHDOG_MS * 1000 || stopping)
        return;
    if (now_in == ON) {
        end_light();
        trip_count++;
    } else if (now_in == RUN && !(lit() && ended + 1 == count)) {
        trip_count++;
        stopping = lit();
        if (!stopping) {
            phase = STILL;
            now_in = HALT;
        }
    }
}

}  // namespace

void start() {
    board_dark();
    board_trigger(false);
    now_in = IDLE;
    phase = STILL;
    burning = NO_LED;
    count = ended = 0;
    stopping = shifting = shifted = flash_over = up = false;
    trip_count = clock_ms = 0;
    pulsed = false;
    clock_at = heard_at = board_now_us();
    for (uint8_t led = 0; led < BOARD_LEDS; led++)
        levels[led] = FULL;
    for (uint8_t i = 0; i < BOARD_STEPS; i++)
        steps[i].hold_us = 0;
}

void poll() {
    const uint32_t now = board_now_us();
    if (lit())
        watch_exposure(now);
    edges(now);
    while (static_cast<int32_t>(now - clock_at) >= 1000) {
        clock_at += 1000;
        clock_ms = clock_ms == 999999999 ? 0 : clock_ms + 1;
        watchdog();
    }
    const uint8_t next = lit() ? ended + 1 : ended;
    if (now_in == RUN && next < count && !shifted && !shifting) {
        shift_in(steps[next].led);
        shifted = true;
    }
}

uint32_t spare_us() {
    const uint32_t now = board_now_us();
    uint32_t spare = 0xFFFFFFFF;
    if (phase != STILL)
        spare = before(now, due) ? due - now : 0;
    if (now_in == ON || now_in == RUN) {
        const uint32_t silent = now - heard_at;
        const uint32_t left = silent < WATCHDOG_MS * 1000 ? WATCHDOG_MS * 1000 - silent : 0;
        if (left < spare && !stopping)
            spare = left;
    }
    return spare > BOARD_SPIN_US ? spare - BOARD_SPIN_US : 0;
}

void heard() { heard_at = board_now_us(); }

State state() { return now_in; }

uint8_t led() { return burning; }

uint8_t done() { return ended; }

uint32_t trips() { return trip_count; }

uint32_t uptime_ms() { return clock_ms; }
uint32_t since_pulse_us() { return since_us; }

void set_level(uint8_t led, uint16_t level) { levels[led] = level; }

void on(uint8_t led, uint32_t hold_ms) {
    shift_in(led);
    put_out();
    stopping = false;
    light_up(led, 0, 0);
    now_in = ON;
    phase = HOLDING;
    due = lit_at + hold_ms * 1000;
}

uint8_t off() {
    const uint8_t was = burning;
    put_out();
    now_in = IDLE;
    flash_over = false;
    return was;
}

void flash(uint8_t led, uint32_t settle_us, uint32_t for_us) {
    shift_in(led);
    put_out();
    now_in = FLASH;
    light_up(led, settle_us, for_us);
    poll();
}

void run(uint8_t how_many, Pace by) {
    shift_in(steps[0].led);
    put_out();
    shifted = true;
    stopping = false;
    pace = by;
    count = how_many;
    ended = 0;
    now_in = RUN;
    phase = DARK;
    run_at = due = board_now_us();
    poll();
}

void end_halt() {
    if (now_in == HALT)
        now_in = IDLE;
}

bool flash_ended() {
    const bool is = flash_over;
    flash_over = false;
    return is;
}

const Burn &last_burn() { return burn; }

}  // namespace light
