/* The subject's button: edges stamped in the interrupt, bounce removed. */
#ifndef BUTTON_H
#define BUTTON_H

#include <stdbool.h>
#include <stdint.h>

#include "clock.h"

void button_init(void);
/* Returns false where nothing has happened. */
bool button_take(bool *pressed, stamp_t *when);
bool button_pressed(void);
/* The contact as it is now, bounces and all. */
bool button_closed(void);

#endif
