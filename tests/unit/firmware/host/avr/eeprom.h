#ifndef HOST_EEPROM_H
#define HOST_EEPROM_H
#include <stddef.h>
void eeprom_read_block(void *target, const void *address, size_t size);
#endif
