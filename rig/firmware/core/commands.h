// Commands from the host: read, remembered, and replied to. What each verb does is in verbs.h.
#ifndef SGP_COMMANDS_H
#define SGP_COMMANDS_H

namespace commands {

void start();

// Act on the command that line::take reported, and reply.
void handle();

// Send the reply of a flash that has ended.
void report_flash();

}  // namespace commands

#endif
