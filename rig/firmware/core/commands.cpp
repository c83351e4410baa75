#include "commands.h"

#include "board.h"
#include "light.h"
#include "line.h"
#include "reply.h"

namespace commands {
namespace {

const uint32_t MAX_SETTLE_US = 1000000;  // and of a gap
const uint32_t MIN_HOLD_US = 10;
const uint32_t MAX_HOLD_US = light::MAX_HOLD_MS * 1000;
const uint32_t ABSENT = 0xFFFFFFFF;  // `-` in the place of an LED
const uint8_t MOST = line::WORDS - 1;

enum Error : uint8_t { NONE, UNKNOWN, ARGUMENTS, LED, TIME, BUSY, LEVEL, STEP };

// What the arguments have to be: n a number, l a number or `-`, p a pace.
struct Verb {
    const char *name;
    const char *arguments;
    bool asks;     // changes nothing and is answered afresh each time
    bool refused;  // while a flash or a sequence runs
    Error (*act)(const uint32_t *args);
    void (*answer)(const uint32_t *args);
};

// The last command acted on or refused.
uint16_t last_seq;
char last_text[line::LONGEST_WORDS];
uint8_t last_length;
bool last_is_flash;
uint16_t flash_seq;
uint8_t found_burning;

bool same(line::Word word, const char *text) {
    uint8_t i = 0;
    while (i < word.length && text[i] == word.at[i] && text[i] != '\0')
        i++;
    return i == word.length && text[i] == '\0';
}

bool number(line::Word word, uint32_t *value) {
    *value = 0;
    for (uint8_t i = 0; i < word.length; i++) {
        const char c = word.at[i];
        if (c < '0' || c > '9')
            return false;
        *value = *value * 10 + static_cast<uint8_t>(c - '0');
    }
    return word.length <= 9;
}

bool argument(line::Word word, char kind, uint32_t *value) {
    if (kind == 'p') {
        *value = same(word, "A") ? light::BY_EXPOSURE : light::BY_TIME;
        return same(word, "A") || same(word, "T");
    }
    if (kind == 'l' && same(word, "-")) {
        *value = ABSENT;
        return true;
    }
    return number(word, value);
}

bool arguments(const char *kinds, uint32_t *args) {
    uint8_t n = 0;
    for (; kinds[n] != '\0'; n++) {
        if (n + 1 >= line::count() || !argument(line::word(static_cast<uint8_t>(n + 1)), kinds[n], args + n))
            return false;
        light::poll();
    }
    return line::count() == n + 1;
}

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
    // Read together: the light goes on while the reply is sent.
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
    flash_seq = last_seq;
    last_is_flash = true;
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
    {"FLASH", "lnn", false, true, flash, nullptr},  // answered at its end
    {"STEP", "nlnnn", false, true, step, step_answer},
    {"RUN", "np", false, true, run, one},
};

const Verb *known(line::Word name) {
    for (const Verb &verb : VERBS)
        if (same(name, verb.name))
            return &verb;
    return nullptr;
}

bool busy() { return light::state() == light::FLASH || light::state() == light::RUN; }

bool repeated() {
    const line::Word text = line::words();
    if (line::seq() != last_seq || text.length != last_length)
        return false;
    for (uint8_t i = 0; i < text.length; i++)
        if (text.at[i] != last_text[i])
            return false;
    return true;
}

void remember() {
    const line::Word text = line::words();
    last_seq = line::seq();
    last_length = text.length;
    for (uint8_t i = 0; i < text.length; i++)
        last_text[i] = text.at[i];
    last_is_flash = false;
    reply::forget();
}

void refuse(Error error, reply::Memory memory) {
    reply::begin(line::seq(), memory);
    reply::word("E");
    reply::sign(static_cast<char>('0' + error));
    reply::word(line::words());
    reply::end();
}

}  // namespace

void start() {
    last_length = 0;
    last_is_flash = false;
    reply::forget();
}

void handle() {
    light::heard();
    const Verb *verb = known(line::word(0));
    const bool asks = verb != nullptr && verb->asks;
    const reply::Memory memory = asks ? reply::PASSING : reply::KEPT;
    if (!asks) {
        if (repeated()) {
            reply::again(last_seq);
            return;
        }
        remember();
    }
    uint32_t args[MOST];
    Error error = NONE;
    if (verb == nullptr)
        error = UNKNOWN;
    else if (!arguments(verb->arguments, args))
        error = ARGUMENTS;
    else if (verb->refused && busy())
        error = BUSY;
    else {
        // What a flash did stands where the next light writes: one that ended in mid-line is told before.
        if (!asks && light::flash_ended())
            report_flash();
        error = verb->act(args);
    }
    if (error != NONE) {
        refuse(error, memory);
        return;
    }
    if (verb->answer == nullptr)
        return;
    reply::begin(line::seq(), memory);
    reply::word("OK");
    reply::word(verb->name);
    verb->answer(args);
    reply::end();
}

void report_flash() {
    reply::begin(flash_seq, last_is_flash ? reply::KEPT : reply::PASSING);
    reply::word("OK");
    reply::word("FLASH");
    led(light::last_burn().led);
    if (light::since_pulse_us() == light::NO_PULSE)
        reply::word("-");
    else
        reply::number(light::since_pulse_us());
    burn(light::last_burn());
    reply::end();
}

}  // namespace commands
