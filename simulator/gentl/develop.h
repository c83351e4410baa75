/* Automatic functions that change a picture after the sensor: white balance and gamma. */
#ifndef DEVELOP_H
#define DEVELOP_H

#include "picture.h"

void develop(uint16_t *grey, const struct shot *shot, const struct control *camera);

#endif
