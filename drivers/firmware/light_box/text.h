/* Numbers to text and back, without the weight of printf. */
#ifndef TEXT_H
#define TEXT_H

#include <stdbool.h>
#include <stdint.h>

#include "clock.h"

/* Each appends at `end` and returns the new end. */
char *put_text(char *end, const char *text);
char *put_number(char *end, uint32_t number);
char *put_signed(char *end, int16_t number);
char *put_hex(char *end, uint32_t number, uint8_t digits);
char *put_stamp(char *end, stamp_t stamp); /* milliseconds with three decimals */

/* Reads up to `digits` upper-case hexadecimal digits; false where one is something else. */
bool read_hex(const char *text, uint8_t digits, uint32_t *number);
/* Reads a whole word of one to ten decimal digits up to `high`. */
bool read_number(const char *word, uint32_t high, uint32_t *number);

uint32_t crc32(const char *text, uint8_t length);

#endif
