/* Pins: bleach OC2A = PB3 (D11), spot OC1A = PB1 (D9), spot_red OC1B = PB2 (D10), fixation OC2B = PD3 (D3);
 * high-current switches PD4 (D4) to PD7 (D7) in the same order, high = high current.
 * spot_green shares OC1B with spot_red and field shares OC2A with bleach: PC2 (A2) and PC3 (A3) say which of the two LEDs
 * the output drives, high = spot_green, field; their high-current switches are PC4 (A4) and PC5 (A5).
 * Trigger of the photographic flash: PB0 (D8).
 *
 * A duty finer than the timer's own step is dithered over 4 or 8 of its periods, spread evenly, by the overflow
 * interrupts. Fast PWM gives a spike of one clock at compare value 0 (ATmega328P datasheet, 15.9.3), so that a period
 * without light means: pin disconnected from its timer and held low.
 */
#include "pwm.h"

#include <avr/interrupt.h>
#include <avr/io.h>

#include "config.h"
#include "limits.h"

#define OUTPUTS 4
#define SELECT_SPOT_GREEN _BV(PC2)
#define SELECT_FIELD _BV(PC3)
#define RANGE_SPOT_GREEN _BV(PC4)
#define RANGE_FIELD _BV(PC5)
#define PORT_C_PINS (SELECT_SPOT_GREEN | SELECT_FIELD | RANGE_SPOT_GREEN | RANGE_FIELD)
#define TRIGGER _BV(PB0)

#define RANGE_PIN(channel) (_BV(4) << (channel))
#define BLEACH_OUTPUT _BV(COM2A1)
#define FIXATION_OUTPUT _BV(COM2B1)
#define SPOT_OUTPUT _BV(COM1A1)
#define SPOT_RED_OUTPUT _BV(COM1B1)

static volatile uint16_t duty[OUTPUTS];
static uint8_t present_range[CHANNELS];
/* The output of each channel is named after the first channel that has it; `owner` is the one that has it now. */
static const uint8_t output_of[CHANNELS] = {BLEACH, SPOT, SPOT_RED, FIXATION, SPOT_RED, BLEACH};
static uint8_t owner[OUTPUTS] = {BLEACH, SPOT, SPOT_RED, FIXATION};

/* Bit n: the n-th period of the cycle carries one count more, for a remainder of 0, 1, 2, ... of 4 or 8. */
static const uint8_t EXTRA_OF_4[4] = {0x0, 0x1, 0x5, 0x7};
static const uint8_t EXTRA_OF_8[8] = {0x00, 0x01, 0x11, 0x49, 0x55, 0x6D, 0x77, 0x7F};

void pwm_init(void)
{
    PORTB &= (uint8_t)~(_BV(PB1) | _BV(PB2) | _BV(PB3));
    PORTD &= (uint8_t)~(_BV(PD3) | 0xF0);
    PORTB &= (uint8_t)~TRIGGER;
    PORTC &= (uint8_t)~PORT_C_PINS;
    DDRC |= PORT_C_PINS;
    DDRB |= TRIGGER;
    DDRB |= _BV(PB1) | _BV(PB2) | _BV(PB3);
    DDRD |= _BV(PD3) | 0xF0;

    TCCR1A = _BV(WGM11) | _BV(WGM10); /* fast PWM up to 1023, both outputs disconnected */
    TIMSK1 = _BV(TOIE1);
    TCCR1B = _BV(WGM12) | _BV(CS10);

    TCCR2A = _BV(WGM21) | _BV(WGM20); /* fast PWM up to 255 */
    TIMSK2 = _BV(TOIE2);
    TCCR2B = _BV(CS21);
}

uint16_t pwm_steps(uint8_t channel, uint16_t level)
{
    uint32_t scaled = (uint32_t)level + (level >> 15); /* 65535 is all of it */
    return (uint16_t)((scaled * channel_limits[channel].steps + 32768UL) >> 16);
}

/* Takes effect with the next period; no light takes effect at once. */
static void write_duty(uint8_t output, uint16_t steps)
{
    duty[output] = steps;
    if (steps)
        return;
    switch (output) {
    case BLEACH:
        TCCR2A &= (uint8_t)~BLEACH_OUTPUT;
        PORTB &= (uint8_t)~_BV(PB3);
        break;
    case SPOT:
        TCCR1A &= (uint8_t)~SPOT_OUTPUT;
        PORTB &= (uint8_t)~_BV(PB1);
        break;
    case SPOT_RED:
        TCCR1A &= (uint8_t)~SPOT_RED_OUTPUT;
        PORTB &= (uint8_t)~_BV(PB2);
        break;
    default:
        TCCR2A &= (uint8_t)~FIXATION_OUTPUT;
        PORTD &= (uint8_t)~_BV(PD3);
        break;
    }
}

static void write_range(uint8_t channel, uint8_t range)
{
    volatile uint8_t *port = channel < SPOT_GREEN ? &PORTD : &PORTC;
    uint8_t pin = channel == SPOT_GREEN ? RANGE_SPOT_GREEN : channel == FIELD ? RANGE_FIELD : RANGE_PIN(channel);
    if (range == HIGH_RANGE)
        *port |= pin;
    else
        *port &= (uint8_t)~pin;
    present_range[channel] = range;
}

static void select(uint8_t channel)
{
    uint8_t pin = output_of[channel] == SPOT_RED ? SELECT_SPOT_GREEN : SELECT_FIELD;
    owner[output_of[channel]] = channel;
    if (pwm_partner(channel) == CHANNELS)
        return;
    if (channel == SPOT_GREEN || channel == FIELD)
        PORTC |= pin;
    else
        PORTC &= (uint8_t)~pin;
}

void pwm_write(uint8_t channel, uint8_t range, uint16_t steps)
{
    uint8_t output = output_of[channel];
    if (steps == 0)
        range = LOW_RANGE; /* a dark channel rests at the low current */
    if (steps == 0 && owner[output] != channel)
        return; /* its partner has the output: what is dark stays dark, what is lit stays lit */
    if (range != present_range[channel] || owner[output] != channel) {
        write_duty(output, 0); /* never a moment of the old duty at the new current, or at the other LED */
        write_range(channel, range);
        select(channel);
    }
    write_duty(output, steps);
    if (steps == 0 && (channel == SPOT_GREEN || channel == FIELD))
        select(output); /* at rest the first of the two has it */
}

uint8_t pwm_partner(uint8_t channel)
{
    switch (channel) {
    case BLEACH: return FIELD;
    case FIELD: return BLEACH;
    case SPOT_RED: return SPOT_GREEN;
    case SPOT_GREEN: return SPOT_RED;
    default: return CHANNELS;
    }
}

void pwm_trigger(bool on)
{
    if (on)
        PORTB |= TRIGGER;
    else
        PORTB &= (uint8_t)~TRIGGER;
}

/* 15 625 times a second: two tests and two stores where nothing changes. */
ISR(TIMER1_OVF_vect)
{
    static uint8_t period = 1;
    uint16_t spot = duty[SPOT], red = duty[SPOT_RED];
    uint8_t control = TCCR1A & (uint8_t)~(SPOT_OUTPUT | SPOT_RED_OUTPUT);
    if (spot | red) {
        spot = (spot >> 3) + ((EXTRA_OF_8[spot & 7] & period) != 0);
        red = (red >> 3) + ((EXTRA_OF_8[red & 7] & period) != 0);
        if (spot) {
            OCR1A = spot - 1;
            control |= SPOT_OUTPUT;
        }
        if (red) {
            OCR1B = red - 1;
            control |= SPOT_RED_OUTPUT;
        }
    }
    TCCR1A = control;
    period = period == 0x80 ? 1 : (uint8_t)(period << 1);
}

ISR(TIMER2_OVF_vect)
{
    static uint8_t period = 1;
    uint16_t bleach = duty[BLEACH], fixation = duty[FIXATION];
    uint8_t control = TCCR2A & (uint8_t)~(BLEACH_OUTPUT | FIXATION_OUTPUT);
    bleach = (bleach >> 2) + ((EXTRA_OF_4[bleach & 3] & period) != 0);
    fixation = (fixation >> 2) + ((EXTRA_OF_4[fixation & 3] & period) != 0);
    if (bleach) {
        OCR2A = (uint8_t)(bleach - 1);
        control |= BLEACH_OUTPUT;
    }
    if (fixation) {
        OCR2B = (uint8_t)(fixation - 1);
        control |= FIXATION_OUTPUT;
    }
    TCCR2A = control;
    period = period == 0x08 ? 1 : (uint8_t)(period << 1);
}
