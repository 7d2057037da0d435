/* ADC0: TMP36 (0.5 V at 0 C, 10 mV/K; Analog Devices datasheet); ADC1: LED supply through 30k/10k.
 * Reference is the 5 V rail, sixteen conversions are averaged.
 */
#include "sensors.h"

#include <avr/io.h>

#define REFERENCE_MV 5000UL
#define AVERAGED 16
#define SUPPLY_DIVIDER 4

static uint16_t sum[2], mean_of_16[2];
static uint8_t taken, input;

static void start_conversion(void)
{
    ADMUX = _BV(REFS0) | input;
    ADCSRA |= _BV(ADSC);
}

void sensors_init(void)
{
    ADCSRA = _BV(ADEN) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0); /* 125 kHz */
    start_conversion();
}

void sensors_poll(void)
{
    if (ADCSRA & _BV(ADSC))
        return;
    sum[input] += ADC;
    if (input == 1 && ++taken == AVERAGED) {
        mean_of_16[0] = sum[0];
        mean_of_16[1] = sum[1];
        sum[0] = sum[1] = 0;
        taken = 0;
    }
    input ^= 1;
    start_conversion();
}

static uint32_t millivolts_times_16(uint8_t which)
{
    return (uint32_t)mean_of_16[which] * REFERENCE_MV / 1024UL;
}

uint16_t sensors_supply_mv(void)
{
    return (uint16_t)(millivolts_times_16(1) * SUPPLY_DIVIDER / AVERAGED);
}

int16_t sensors_temperature_dc(void)
{
    return (int16_t)(millivolts_times_16(0) / AVERAGED) - 500;
}
