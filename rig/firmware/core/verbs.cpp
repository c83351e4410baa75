#include "verbs.h"

#include "board.h"
#include "light.h"
#include "reply.h"

namespace verbs {
namespace {

const uint32_t MAX_SETTLE_US = 1000000;  // also the longest gap
const uint32_t MIN_HOLD_US = 10;
const uint32_t MAX_HOLD_US = light::MAX_HOLD_MS * 1000;

uint8_t found_burning;

void led(uint8_t led) {
    if (led == NO_LED)
        reply::word("-");
    else
        reply::number(led);
}

void burn(const Burn &burn) {
    reply::number(burn.lit_us);
    if (burn.seen == NEVER) {
        reply::word("-");
        return;
    }
    reply::number(burn.active_us);
    if (burn.seen == STILL_UP)
        reply::sign('+');
}

void numbers(const uint32_t *args, uint8_t how_many) {
    for (uint8_t i = 0; i < how_many; i++)
        reply::number(args[i]);
}

uint8_t as_led(uint32_t arg) { return arg == ABSENT ? NO_LED : static_cast<uint8_t>(arg); }

bool no_such_led(uint32_t arg) { return arg != ABSENT && arg >= BOARD_LEDS; }

bool bad_times(uint32_t settle_us, uint32_t hold_us) {
    return settle_us > MAX_SETTLE_US || hold_us < MIN_HOLD_US || settle_us + hold_us > MAX_HOLD_US;
}

Error nothing(const uint32_t *) { return NONE; }

void id_answer(const uint32_t *) {
    reply::word("sgp-led-board");
    reply::word("2");
    reply::word("2.0.0");
    reply::number(BOARD_LEDS);
    reply::number(light::MAX_HOLD_MS);
    reply::number(light::WATCHDOG_MS);
    reply::number(BOARD_STEPS);
}

void status_answer(const uint32_t *) {
    static const char *const STATES[] = {"IDLE", "ON", "FLASH", "RUN", "HALT"};
    // Read together, because the light may change while the reply is sent.
    const uint8_t burning = light::led();
    const uint8_t done = light::done();
    const light::State state = light::state();
    const uint32_t trips = light::trips();
    reply::number(light::uptime_ms());
    led(burning);
    reply::number(line::faults());
    reply::number(trips);
    const uint16_t temperature = board_temperature_dk();
    if (temperature == 0)
        reply::word("-");
    else
        reply::number(temperature);
    reply::word(STATES[state]);
    reply::number(done);
}

Error did(const uint32_t *args) { return args[0] < light::done() ? NONE : STEP; }

void did_answer(const uint32_t *args) {
    const Record &record = records[args[0]];
    reply::number(args[0]);
    led(record.burn.led);
    reply::number(record.trigger_us);
    burn(record.burn);
}

Error on(const uint32_t *args) {
    if (args[0] >= BOARD_LEDS)
        return LED;
    if (args[1] < 1 || args[1] > light::MAX_HOLD_MS)
        return TIME;
    light::on(static_cast<uint8_t>(args[0]), args[1]);
    return NONE;
}

void two(const uint32_t *args) { numbers(args, 2); }

Error off(const uint32_t *) {
    found_burning = light::off();
    return NONE;
}

void off_answer(const uint32_t *) { led(found_burning); }

Error level(const uint32_t *args) {
    if (args[0] >= BOARD_LEDS)
        return LED;
    if (args[1] > light::FULL)
        return LEVEL;
    light::set_level(static_cast<uint8_t>(args[0]), static_cast<uint16_t>(args[1]));
    light::end_halt();
    return NONE;
}

Error flash(const uint32_t *args) {
    if (no_such_led(args[0]))
        return LED;
    if (bad_times(args[1], args[2]))
        return TIME;
    light::flash(as_led(args[0]), args[1], args[2]);
    return NONE;
}

Error step(const uint32_t *args) {
    if (args[0] >= BOARD_STEPS)
        return STEP;
    if (no_such_led(args[1]))
        return LED;
    if (bad_times(args[2], args[3]) || args[4] > MAX_SETTLE_US)
        return TIME;
    Step &step = steps[args[0]];
    step.led = as_led(args[1]);
    step.settle_us = args[2];
    step.hold_us = args[3];
    step.gap_us = args[4];
    light::end_halt();
    return NONE;
}

void step_answer(const uint32_t *args) {
    reply::number(args[0]);
    led(as_led(args[1]));
    numbers(args + 2, 3);
}

Error run(const uint32_t *args) {
    if (args[0] < 1 || args[0] > BOARD_STEPS)
        return STEP;
    for (uint8_t i = 0; i < args[0]; i++)
        if (steps[i].hold_us == 0)
            return STEP;
    light::run(static_cast<uint8_t>(args[0]), static_cast<light::Pace>(args[1]));
    return NONE;
}

void one(const uint32_t *args) { numbers(args, 1); }

const Verb VERBS[] = {
    {"ID", "", true, false, nothing, id_answer},
    {"STATUS", "", true, false, nothing, status_answer},
    {"DID", "n", true, false, did, did_answer},
    {"OFF", "", false, false, off, off_answer},
    {"ON", "nn", false, true, on, two},
    {"LEVEL", "nn", false, true, level, two},
    {"FLASH", "lnn", false, true, flash, nullptr},
    {"STEP", "nlnnn", false, true, step, step_answer},
    {"RUN", "np", false, true, run, one},
};

}  // namespace

const Verb *known(line::Word name) {
    for (const Verb &verb : VERBS)
        if (name.is(verb.name))
            return &verb;
    return nullptr;
}

void answer_flash() {
    const Burn &last = light::last_burn();
    led(last.led);
    if (light::since_pulse_us() == light::NO_PULSE)
        reply::word("-");
    else
        reply::number(light::since_pulse_us());
    burn(last);
}

}  // namespace verbs
