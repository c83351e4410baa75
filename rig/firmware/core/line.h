// Lines from the host: assembled from bytes, checked, split into words.
#ifndef SGP_LINE_H
#define SGP_LINE_H

#include <stdint.h>

namespace line {

const uint8_t LONGEST = 64;
const uint8_t LONGEST_WORDS = LONGEST - 11;  // without mark, sequence number, space and checksum

struct Word {
    const char *at;
    uint8_t length;
    bool is(const char *text) const;
};

void start();

// Take the next byte. True if it ended a complete, undamaged command, which is valid until the next byte is taken.
bool take(uint8_t byte);

// The command that `take` returned:
uint16_t seq();
Word words();          // all words, as received
uint8_t count();       // number of words including the verb; WORDS + 1 if there are more than WORDS
Word word(uint8_t n);  // n < WORDS
const uint8_t WORDS = 6;

// Number of damaged lines since the start.
uint32_t faults();

// CRC-16/CCITT-FALSE after one more byte; the initial value is CRC_START.
const uint16_t CRC_START = 0xFFFF;
uint16_t crc(uint16_t sum, uint8_t byte);

}  // namespace line

#endif
