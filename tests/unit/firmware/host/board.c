/* The board around the firmware: registers, the serial line, a button, and time that passes on request. */
#include <avr/eeprom.h>
#include <avr/io.h>
#include <stdbool.h>
#include <string.h>

#include "button.h"
#include "clock.h"
#include "light.h"
#include "protocol.h"
#include "sensors.h"
#include "uart.h"

volatile uint8_t PORTB, PORTC, PORTD, DDRB, DDRC, DDRD, PIND = 0xFF;
volatile uint8_t PCMSK2, PCIFR, PCICR;
volatile uint8_t TCCR0A, TCCR0B, OCR0A, TCNT0, TIMSK0, TIFR0;
volatile uint8_t TCCR1A, TCCR1B, TIMSK1, TCCR2A, TCCR2B, TIMSK2, OCR2A, OCR2B;
volatile uint16_t OCR1A, OCR1B, UBRR0, ADC;
volatile uint8_t UCSR0A, UCSR0B, UCSR0C, UDR0, ADMUX, ADCSRA, MCUSR;

#define SENT_SIZE 65536u
static char sent[SENT_SIZE];
static uint32_t sent_size;
#define EEPROM_SIZE 1024u
static char eeprom[EEPROM_SIZE];
static uint32_t eeprom_writes;
static uint32_t cut_after = UINT32_MAX; /* power fails after so many bytes more */
static double seconds[6][2]; /* at full duty, for each channel and current */
static uint16_t adc[2];

void TIMER0_COMPA_vect(void);
void TIMER1_OVF_vect(void);
void TIMER2_OVF_vect(void);
void PCINT2_vect(void);
void USART_RX_vect(void);
void USART_UDRE_vect(void);

void eeprom_read_block(void *target, const void *address, size_t size)
{
    memcpy(target, eeprom + (size_t)address, size);
}

void eeprom_update_block(const void *source, void *address, size_t size)
{
    for (size_t n = 0; n < size && cut_after; n++, cut_after--) {
        char *cell = eeprom + (size_t)address + n;
        eeprom_writes += *cell != ((const char *)source)[n];
        *cell = ((const char *)source)[n];
    }
}

void eeprom_busy_wait(void)
{
}

void board_serve_interrupts(void)
{
    while (UCSR0B & _BV(UDRIE0)) {
        USART_UDRE_vect();
        if ((UCSR0B & _BV(UDRIE0)) && sent_size < SENT_SIZE)
            sent[sent_size++] = (char)UDR0;
    }
}

static void poll(void)
{
    protocol_poll();
    ADCSRA &= (uint8_t)~_BV(ADSC); /* the conversion is over */
    ADC = adc[ADMUX & 15];
    sensors_poll();
    board_serve_interrupts();
}

void board_start(const char *memory, uint8_t reset_flags)
{
    memcpy(eeprom, memory, sizeof eeprom);
    light_init();
    clock_init();
    uart_init();
    button_init();
    sensors_init();
    TCNT0 = 2;
    protocol_init(reset_flags);
    light_remember();
    poll();
    TCNT0 = 0;
}

void board_outputs(uint32_t steps[4]);

/* What the pins show: output, select line and current switch say which LED is lit and how. */
static void watch_light(void)
{
    static const uint8_t high[6] = {4, 5, 6, 7, PC4, PC5}; /* D4 to D7, A4, A5 */
    uint32_t steps[4];
    board_outputs(steps);
    for (int n = 0; n < 4; n++) {
        bool other = (n == 2 && (PORTC & _BV(PC2))) || (n == 0 && (PORTC & _BV(PC3)));
        int channel = !other ? n : n == 2 ? 4 : 5;
        uint8_t port = channel < 4 ? PORTD : PORTC;
        seconds[channel][(port & _BV(high[channel])) != 0] += steps[n] / (n == 0 || n == 3 ? 2048.0 : 8192.0) / 1000;
    }
}

void board_pass(uint32_t ms)
{
    while (ms--) {
        TIMER0_COMPA_vect();
        poll();
    }
}

/* The same, noting the light; a level that a command sets within a ms counts for all of it. */
void board_pass_watched(uint32_t ms)
{
    while (ms--) {
        watch_light();
        board_pass(1);
    }
}

void board_take_seconds(double target[12])
{
    memcpy(target, seconds, sizeof seconds);
    memset(seconds, 0, sizeof seconds);
}

void board_memory(char *target)
{
    memcpy(target, eeprom, sizeof eeprom);
}

uint32_t board_memory_writes(void)
{
    return eeprom_writes;
}

void board_cut_after(uint32_t bytes)
{
    cut_after = bytes;
}

void board_send(const char *bytes, uint32_t size, bool damaged)
{
    UCSR0A = damaged ? _BV(FE0) : 0;
    for (uint32_t n = 0; n < size; n++) {
        UDR0 = (uint8_t)bytes[n];
        USART_RX_vect();
        poll();
    }
    UCSR0A = 0;
}

/* Bytes that come while the main loop does not run. */
void board_send_at_once(const char *bytes, uint32_t size)
{
    for (uint32_t n = 0; n < size; n++) {
        UDR0 = (uint8_t)bytes[n];
        USART_RX_vect();
    }
    poll();
}

uint32_t board_take(char *target)
{
    uint32_t size = sent_size;
    memcpy(target, sent, size);
    sent_size = 0;
    return size;
}

void board_contact(bool closed)
{
    PIND = closed ? (uint8_t)~_BV(PD2) : 0xFF;
    PCINT2_vect();
    poll();
}

void board_analog(uint16_t temperature, uint16_t supply)
{
    adc[0] = temperature;
    adc[1] = supply;
    for (int n = 0; n < 64; n++)
        poll();
}

void board_ticks(uint8_t ticks)
{
    TCNT0 = ticks;
}

/* Steps at each of the four outputs over eight periods of their timers: 8192 and 1024 times 2 are always on. */
void board_outputs(uint32_t steps[4])
{
    memset(steps, 0, 4 * sizeof *steps);
    for (int period = 0; period < 8; period++) {
        TIMER1_OVF_vect();
        TIMER2_OVF_vect();
        steps[0] += TCCR2A & _BV(COM2A1) ? OCR2A + 1u : 0;
        steps[1] += TCCR1A & _BV(COM1A1) ? OCR1A + 1u : 0;
        steps[2] += TCCR1A & _BV(COM1B1) ? OCR1B + 1u : 0;
        steps[3] += TCCR2A & _BV(COM2B1) ? OCR2B + 1u : 0;
    }
}

uint8_t board_port(char name)
{
    return name == 'B' ? PORTB : name == 'C' ? PORTC : PORTD;
}

uint8_t board_directions(char name)
{
    return name == 'B' ? DDRB : name == 'C' ? DDRC : DDRD;
}
