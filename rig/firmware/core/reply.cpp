#include "reply.h"

#include "board.h"
#include "light.h"

namespace reply {
namespace {

const uint8_t LONGEST_KEPT = line::LONGEST_WORDS + 4;  // a refusal: space, E, number, space, the words
const uint32_t TOO_LARGE = 1000000000;
const uint32_t POWERS[] = {100000000, 10000000, 1000000, 100000, 10000, 1000, 100, 10, 1};

uint16_t sum;
bool keeping;
char kept[LONGEST_KEPT];
uint8_t kept_length;

void put(uint8_t byte) {
    while (!board_put(byte))
        light::poll();
    light::poll();
}

void checked(char c) {
    sum = line::crc(sum, static_cast<uint8_t>(c));
    put(static_cast<uint8_t>(c));
}

void part(char c) {
    if (keeping && kept_length < LONGEST_KEPT)
        kept[kept_length++] = c;
    checked(c);
}

char digit(uint16_t value) { return static_cast<char>(value < 10 ? '0' + value : 'A' + value - 10); }

void head(uint16_t seq) {
    sum = line::CRC_START;
    checked('<');
    for (int8_t shift = 12; shift >= 0; shift = static_cast<int8_t>(shift - 4))
        checked(digit(seq >> shift & 0xF));
}

}  // namespace

void begin(uint16_t seq, Memory memory) {
    keeping = memory == KEPT;
    if (keeping)
        kept_length = 0;
    head(seq);
}

void word(const char *text) {
    part(' ');
    while (*text != '\0')
        part(*text++);
}

void word(line::Word text) {
    part(' ');
    for (uint8_t i = 0; i < text.length; i++)
        part(text.at[i]);
}

void number(uint32_t value) {
    part(' ');
    while (value >= TOO_LARGE)
        value -= TOO_LARGE;
    // Subtraction, because a small processor divides 32 bits too slowly between two edges.
    bool leading = true;
    for (const uint32_t power : POWERS) {
        uint8_t times = 0;
        for (; value >= power; times++)
            value -= power;
        leading = leading && times == 0 && power > 1;
        if (!leading)
            part(digit(times));
    }
}

void sign(char c) { part(c); }

void end() {
    const uint16_t checksum = sum;
    put('*');
    for (int8_t shift = 12; shift >= 0; shift = static_cast<int8_t>(shift - 4))
        put(static_cast<uint8_t>(digit(checksum >> shift & 0xF)));
    put('\n');
}

void forget() { kept_length = 0; }

void again(uint16_t seq) {
    if (kept_length == 0)
        return;
    head(seq);
    for (uint8_t i = 0; i < kept_length; i++)
        checked(kept[i]);
    end();
}

}  // namespace reply
