// Replies to the host, sent while they are composed. One is kept, to send it again if its command is repeated.
#ifndef SGP_REPLY_H
#define SGP_REPLY_H

#include <stdint.h>

#include "line.h"

namespace reply {

enum Memory : uint8_t { PASSING, KEPT };

// To send a reply: call begin, then one function per word (each sends the space before the word), then end.
void begin(uint16_t seq, Memory memory);
void word(const char *text);
void word(line::Word text);
void number(uint32_t value);  // modulo 10^9
void sign(char c);            // a character appended to the previous word
void end();

// Forget the kept reply.
void forget();

// Send the kept reply again, if there is one.
void again(uint16_t seq);

}  // namespace reply

#endif
