// The action and the reply of each verb.
#ifndef SGP_VERBS_H
#define SGP_VERBS_H

#include "line.h"

namespace verbs {

enum Error : uint8_t { NONE, UNKNOWN, ARGUMENTS, LED, TIME, BUSY, LEVEL, STEP };

const uint32_t ABSENT = 0xFFFFFFFF;  // `-` instead of an LED
const uint8_t MOST_ARGUMENTS = line::WORDS - 1;

// Kinds of arguments: n is a number, l a number or `-`, p a pace.
struct Verb {
    const char *name;
    const char *arguments;
    bool asks;     // a query: changes nothing and is answered with current values each time
    bool refused;  // refused while a flash or a sequence runs
    Error (*act)(const uint32_t *args);
    void (*answer)(const uint32_t *args);  // null for a flash, which is answered at its end
};

// The verb of this name, or null.
const Verb *known(line::Word name);

// Send the words that follow FLASH in its reply.
void answer_flash();

}  // namespace verbs

#endif
