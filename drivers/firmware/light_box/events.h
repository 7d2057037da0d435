/* Things that happen by themselves: numbered, stamped, sent once and kept for asking again. */
#ifndef EVENTS_H
#define EVENTS_H

#include <stdint.h>

#include "clock.h"

#define EVENT_SIZE 48

/* A letter pair of the protocol, one argument letter or digit, and when. */
void events_add(const char *type, char argument, stamp_t when);
void events_watch_button(void);
/* Writes the next unsent event without its checksum; returns its end, or 0 where there is none. */
char *events_next(char *text);
/* Writes a kept event of that number; returns its end, or 0 where it is no longer kept. */
char *events_again(uint8_t number, char *end);
/* The number of the latest event. */
uint8_t events_latest(void);

#endif
