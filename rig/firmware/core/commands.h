// Handling of commands from the host: parsing, memory of the last command, and reply. verbs.h defines the verbs.
#ifndef SGP_COMMANDS_H
#define SGP_COMMANDS_H

namespace commands {

void start();

// Act on the command that line::take returned, and reply.
void handle();

// Send the reply of a flash that has ended.
void report_flash();

}  // namespace commands

#endif
