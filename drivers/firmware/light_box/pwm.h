/* Pulse-width modulation of the four channels and their current ranges. */
#ifndef PWM_H
#define PWM_H

#include <stdbool.h>
#include <stdint.h>

void pwm_init(void);
/* The channel that shares its output with this one; CHANNELS where none does. */
uint8_t pwm_partner(uint8_t channel);
/* Drives the trigger of the photographic flash. */
void pwm_trigger(bool on);
/* Drive a channel; 0 steps is a pin held low. Call with interrupts off. */
void pwm_write(uint8_t channel, uint8_t range, uint16_t steps);
uint16_t pwm_steps(uint8_t channel, uint16_t level);

#endif
