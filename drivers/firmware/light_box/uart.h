/* The serial line: interrupt-driven both ways, whole lines out. */
#ifndef UART_H
#define UART_H

#include <stdbool.h>
#include <stdint.h>

#include "clock.h"

void uart_init(void);
/* Returns false where nothing has arrived. */
bool uart_read(uint8_t *byte);
void uart_write(const char *text);
/* When the latest line end arrived. */
stamp_t uart_line_stamp(void);
/* Bytes lost since power-on because they came faster than they were read, or with a framing error. */
uint16_t uart_lost(void);

#endif
