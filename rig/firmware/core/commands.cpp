#include "commands.h"

#include "light.h"
#include "line.h"
#include "reply.h"
#include "verbs.h"

namespace commands {
namespace {

using verbs::Verb;

// The last command acted on or refused.
uint16_t last_seq;
char last_text[line::LONGEST_WORDS];
uint8_t last_length;
bool last_is_flash;
uint16_t flash_seq;

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
        *value = word.is("A") ? light::BY_EXPOSURE : light::BY_TIME;
        return word.is("A") || word.is("T");
    }
    if (kind == 'l' && word.is("-")) {
        *value = verbs::ABSENT;
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

void refuse(verbs::Error error, reply::Memory memory) {
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
    const Verb *verb = verbs::known(line::word(0));
    const bool asks = verb != nullptr && verb->asks;
    const reply::Memory memory = asks ? reply::PASSING : reply::KEPT;
    if (!asks) {
        if (repeated()) {
            reply::again(last_seq);
            return;
        }
        remember();
    }
    uint32_t args[verbs::MOST_ARGUMENTS];
    verbs::Error error = verbs::NONE;
    if (verb == nullptr)
        error = verbs::UNKNOWN;
    else if (!arguments(verb->arguments, args))
        error = verbs::ARGUMENTS;
    else if (verb->refused && busy())
        error = verbs::BUSY;
    else {
        // The next light overwrites the record of the flash: report a flash that ended during the line first.
        if (!asks && light::flash_ended())
            report_flash();
        error = verb->act(args);
    }
    if (error != verbs::NONE) {
        refuse(error, memory);
        return;
    }
    if (verb->answer == nullptr) {
        flash_seq = last_seq;
        last_is_flash = true;
        return;
    }
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
    verbs::answer_flash();
    reply::end();
}

}  // namespace commands
