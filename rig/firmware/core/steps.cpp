#include "steps.h"

Step steps[BOARD_STEPS];
Record records[BOARD_STEPS];
