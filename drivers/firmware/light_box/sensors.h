/* Supply voltage of the LEDs and temperature next to them. */
#ifndef SENSORS_H
#define SENSORS_H

#include <stdint.h>

void sensors_init(void);
/* Take a conversion that has finished and start the next; never waits. */
void sensors_poll(void);
uint16_t sensors_supply_mv(void);
int16_t sensors_temperature_dc(void); /* tenths of a degree Celsius */

#endif
