/* SPDX-License-Identifier: Apache-2.0 */
#include "uart.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>

#include "protocol.h"
#include "watch.h"

#define BAUD 250000UL
#define RECEIVED 128 /* a power of two; more than a line */
#define SENT 256     /* range of an 8-bit index */

static volatile uint8_t received[RECEIVED], received_head, received_tail;
static volatile uint8_t sent[SENT], sent_head, sent_tail;
volatile uint16_t uart_lost;

void uart_begin(void) {
    UCSR0A = _BV(U2X0); /* before the rate: simavr computes the duration of a byte when the rate is written */
    UBRR0 = F_CPU / (8 * BAUD) - 1; /* exact at 16 MHz */
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
}

ISR(USART_RX_vect) {
    uint8_t status = UCSR0A, byte = UDR0; /* The status belongs to the byte and must be read first. */
    if (status & _BV(DOR0)) uart_lost++;
    if (byte == ABORT_BYTE) {
        fault_enter(F_ABORT);
        received_tail = received_head; /* Lines from before the abort must not be carried out after it. */
    }
    uint8_t next = (received_head + 1) & (RECEIVED - 1);
    if (next == received_tail) {
        uart_lost++;
        return;
    }
    received[received_head] = byte;
    received_head = next;
}

bool uart_waiting(void) {
    return received_head != received_tail;
}

int16_t uart_take(void) {
    int16_t byte = -1;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        if (uart_waiting()) {
            byte = received[received_tail];
            received_tail = (received_tail + 1) & (RECEIVED - 1);
        }
    }
    return byte;
}

ISR(USART_UDRE_vect) {
    if (sent_head == sent_tail)
        UCSR0B &= (uint8_t)~_BV(UDRIE0);
    else
        UDR0 = sent[sent_tail++];
}

void uart_send(const char *bytes, uint8_t length) {
    while (length--) {
        uint8_t next = sent_head + 1;
        while (next == sent_tail) {} /* At most 5 ms for the longest reply; the watchdog is not fed here. */
        sent[sent_head] = (uint8_t)*bytes++;
        sent_head = next;
        ATOMIC_BLOCK(ATOMIC_RESTORESTATE) UCSR0B |= _BV(UDRIE0);
    }
}
