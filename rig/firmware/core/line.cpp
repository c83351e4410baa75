#include "line.h"

namespace line {
namespace {

const uint8_t MARK_AND_SEQ = 5;
const uint8_t STAR_AND_CRC = 5;

char text[LONGEST + 1];  // one more, because the CR before the line end is not counted
uint8_t length;
uint16_t sum;
uint8_t star;  // index of the first '*', 0 if not seen
uint32_t damaged;
Word body;
uint8_t word_count;
Word found[WORDS];

void clear() {
    length = 0;
    sum = CRC_START;
    star = 0;
}

// Parse four upper-case hexadecimal digits; false if they are invalid.
bool hex(const char *at, uint16_t *value) {
    *value = 0;
    for (uint8_t i = 0; i < 4; i++) {
        const char c = at[i];
        uint8_t digit;
        if (c >= '0' && c <= '9')
            digit = static_cast<uint8_t>(c - '0');
        else if (c >= 'A' && c <= 'F')
            digit = static_cast<uint8_t>(c - 'A' + 10);
        else
            return false;
        *value = static_cast<uint16_t>(*value << 4 | digit);
    }
    return true;
}

// Split into words of characters from '!' to '~', with exactly one space before each.
bool split() {
    word_count = 0;
    uint8_t i = MARK_AND_SEQ;
    while (i < star) {
        if (text[i++] != ' ')
            return false;
        const uint8_t from = i;
        while (i < star && text[i] >= '!' && text[i] <= '~')
            i++;
        if (i == from)
            return false;
        if (word_count < WORDS) {
            found[word_count].at = text + from;
            found[word_count].length = static_cast<uint8_t>(i - from);
        }
        if (word_count <= WORDS)
            word_count++;
    }
    body = Word{text + MARK_AND_SEQ + 1, static_cast<uint8_t>(star - MARK_AND_SEQ - 1)};
    return word_count > 0;
}

bool whole() {
    uint16_t ignored, stated;
    return star >= MARK_AND_SEQ && length == star + STAR_AND_CRC && text[0] == '>' && hex(text + 1, &ignored) &&
           hex(text + star + 1, &stated) && stated == sum && split();
}

}  // namespace

bool Word::is(const char *text) const {
    uint8_t i = 0;
    while (i < length && text[i] == at[i] && text[i] != '\0')
        i++;
    return i == length && text[i] == '\0';
}

uint16_t crc(uint16_t now, uint8_t byte) {
    // The bitwise rule of polynomial 0x1021 for a complete byte at once.
    now = static_cast<uint16_t>(now >> 8 | now << 8);
    now = static_cast<uint16_t>(now ^ byte);
    now = static_cast<uint16_t>(now ^ (now & 0xFF) >> 4);
    now = static_cast<uint16_t>(now ^ now << 12);
    return static_cast<uint16_t>(now ^ (now & 0xFF) << 5);
}

void start() {
    clear();
    damaged = 0;
}

bool take(uint8_t byte) {
    if (byte != '\n') {
        if (byte == '*' && star == 0)
            star = length;
        if (star == 0)
            sum = crc(sum, byte);
        if (length < sizeof text)
            text[length] = static_cast<char>(byte);
        // Counts one byte more than it keeps: the line is then too long, however many bytes follow.
        if (length <= sizeof text)
            length++;
        return false;
    }
    if (length > 0 && length <= sizeof text && text[length - 1] == '\r')
        length--;
    const bool any = length > 0 && length <= LONGEST;
    const bool good = any && whole();
    if (any && !good)
        damaged++;
    clear();
    return good;
}

uint16_t seq() {
    uint16_t value;
    hex(text + 1, &value);
    return value;
}

Word words() { return body; }

uint8_t count() { return word_count; }

Word word(uint8_t n) { return found[n]; }

uint32_t faults() { return damaged; }

}  // namespace line
