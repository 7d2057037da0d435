/* What each command does. */
#ifndef COMMANDS_H
#define COMMANDS_H

#include <stdint.h>

#define REPLY_SIZE 96

void commands_init(uint8_t reset_cause);
/* Runs "VERB arguments" (cut into words in place), writes OK and fields or ER and a code, returns the end. */
char *commands_run(char *request, char *end);
void commands_count_bad_line(void);
/* Makes events of the moments in which the box itself went dark. */
void commands_watch_light(void);

#endif
