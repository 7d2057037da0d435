#include "uart.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>

#include "config.h"

#define RX_SIZE 128u /* powers of two */
#define TX_SIZE 128u

static volatile uint8_t rx_ring[RX_SIZE], tx_ring[TX_SIZE];
static volatile uint8_t rx_head, rx_tail, tx_head, tx_tail;
static volatile uint16_t lost;
static volatile stamp_t line_stamp;

void uart_init(void)
{
    UCSR0A = _BV(U2X0); /* double speed: 117 647 Bd, 2.1 % from nominal, as the Arduino core has it */
    UBRR0 = (uint16_t)((F_CPU + 4 * BAUD_RATE) / (8 * BAUD_RATE) - 1);
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00); /* 8N1 */
    UCSR0B = _BV(RXCIE0) | _BV(RXEN0) | _BV(TXEN0);
}

ISR(USART_RX_vect)
{
    uint8_t damaged = UCSR0A & (_BV(FE0) | _BV(DOR0));
    uint8_t byte = UDR0;
    uint8_t next = (rx_head + 1) & (RX_SIZE - 1);
    if (damaged)
        lost++;
    if (next == rx_tail) {
        lost++;
        return;
    }
    if (byte == '\n')
        line_stamp = clock_now_locked();
    rx_ring[rx_head] = byte;
    rx_head = next;
}

ISR(USART_UDRE_vect)
{
    if (tx_head == tx_tail) {
        UCSR0B &= (uint8_t)~_BV(UDRIE0);
        return;
    }
    UDR0 = tx_ring[tx_tail];
    tx_tail = (tx_tail + 1) & (TX_SIZE - 1);
}

bool uart_read(uint8_t *byte)
{
    if (rx_head == rx_tail)
        return false;
    *byte = rx_ring[rx_tail];
    rx_tail = (rx_tail + 1) & (RX_SIZE - 1);
    return true;
}

void uart_write(const char *text)
{
    for (; *text; text++) {
        uint8_t next = (tx_head + 1) & (TX_SIZE - 1);
        while (next == tx_tail)
            ; /* the transmit interrupt makes room within 87 us */
        tx_ring[tx_head] = (uint8_t)*text;
        tx_head = next;
        ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { UCSR0B |= _BV(UDRIE0); }
    }
}

stamp_t uart_line_stamp(void)
{
    stamp_t stamp;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { stamp = line_stamp; }
    return stamp;
}

uint16_t uart_lost(void)
{
    uint16_t count;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { count = lost; }
    return count;
}
