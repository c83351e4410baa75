// What each verb does, and what it answers.
#ifndef SGP_VERBS_H
#define SGP_VERBS_H

#include "line.h"

namespace verbs {

enum Error : uint8_t { NONE, UNKNOWN, ARGUMENTS, LED, TIME, BUSY, LEVEL, STEP };

const uint32_t ABSENT = 0xFFFFFFFF;  // `-` in the place of an LED
const uint8_t MOST_ARGUMENTS = line::WORDS - 1;

// What the arguments have to be: n a number, l a number or `-`, p a pace.
struct Verb {
    const char *name;
    const char *arguments;
    bool asks;     // changes nothing and is answered afresh each time
    bool refused;  // while a flash or a sequence runs
    Error (*act)(const uint32_t *args);
    void (*answer)(const uint32_t *args);  // null for a flash, which is answered at its end
};

// The verb of this name, or null.
const Verb *known(line::Word name);

// The words that follow FLASH when it has ended.
void answer_flash();

}  // namespace verbs

#endif
