#ifndef HOST_EEPROM_H
#define HOST_EEPROM_H
#include <stddef.h>
void eeprom_read_block(void *target, const void *address, size_t size);
void eeprom_update_block(const void *source, void *address, size_t size);
void eeprom_busy_wait(void);
#endif
