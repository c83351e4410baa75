// Replies to the host, sent as they are made. One is kept, to be sent again when its command is repeated.
#ifndef SGP_REPLY_H
#define SGP_REPLY_H

#include <stdint.h>

#include "line.h"

namespace reply {

enum Memory : uint8_t { PASSING, KEPT };

// A reply: begin, then its words, each with the space before it, then end.
void begin(uint16_t seq, Memory memory);
void word(const char *text);
void word(line::Word text);
void number(uint32_t value);  // modulo 10^9
void sign(char c);            // a character on the word before it
void end();

// Forget the kept reply.
void forget();

// Send the kept reply again; nothing where there is none.
void again(uint16_t seq);

}  // namespace reply

#endif
