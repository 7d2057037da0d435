/* The registers of an ATmega328P that the firmware touches, as plain variables of a program on this machine. */
#ifndef HOST_IO_H
#define HOST_IO_H
#include <stdint.h>

#define _BV(bit) (1u << (bit))

extern volatile uint8_t PORTB, PORTC, PORTD, DDRB, DDRC, DDRD, PIND;
extern volatile uint8_t PCMSK2, PCIFR, PCICR;
extern volatile uint8_t TCCR0A, TCCR0B, OCR0A, TCNT0, TIMSK0, TIFR0;
extern volatile uint8_t TCCR1A, TCCR1B, TIMSK1, TCCR2A, TCCR2B, TIMSK2, OCR2A, OCR2B;
extern volatile uint16_t OCR1A, OCR1B, UBRR0, ADC;
extern volatile uint8_t UCSR0A, UCSR0B, UCSR0C, UDR0, ADMUX, ADCSRA, MCUSR;

enum { PB0, PB1, PB2, PB3 };
enum { PC2 = 2, PC3, PC4, PC5 };
enum { PD2 = 2, PD3 };
enum { PCINT18 = 2, PCIF2 = 2, PCIE2 = 2 };
enum { WGM01 = 1, OCIE0A = 1, OCF0A = 1, CS00 = 0, CS01 = 1 };
enum { WGM10 = 0, WGM11 = 1, WGM12 = 3, TOIE1 = 0, CS10 = 0, COM1B1 = 5, COM1A1 = 7 };
enum { WGM20 = 0, WGM21 = 1, TOIE2 = 0, CS21 = 1, COM2B1 = 5, COM2A1 = 7 };
enum { U2X0 = 1, UCSZ00 = 1, UCSZ01 = 2, RXCIE0 = 7, RXEN0 = 4, TXEN0 = 3, UDRIE0 = 5, FE0 = 4, DOR0 = 3 };
enum { REFS0 = 6, ADEN = 7, ADSC = 6, ADPS0 = 0, ADPS1 = 1, ADPS2 = 2 };
enum { PORF = 0, EXTRF = 1, BORF = 2, WDRF = 3 };

#endif
