// Lines from the host: put together from bytes, checked, split into words.
#ifndef SGP_LINE_H
#define SGP_LINE_H

#include <stdint.h>

namespace line {

const uint8_t LONGEST = 64;
const uint8_t LONGEST_WORDS = LONGEST - 11;  // without mark, number, space and checksum

struct Word {
    const char *at;
    uint8_t length;
    bool is(const char *text) const;
};

void start();

// Take the next byte. True where it ended a whole, undamaged command, which stays until the next byte is taken.
bool take(uint8_t byte);

// Of the command that `take` reported:
uint16_t seq();
Word words();          // all of them, as they came
uint8_t count();       // how many words, the verb among them; more than WORDS reads WORDS + 1
Word word(uint8_t n);  // n < WORDS
const uint8_t WORDS = 6;

// Damaged lines since the start.
uint32_t faults();

// CRC-16/CCITT-FALSE, one byte on; it starts at CRC_START.
const uint16_t CRC_START = 0xFFFF;
uint16_t crc(uint16_t sum, uint8_t byte);

}  // namespace line

#endif
