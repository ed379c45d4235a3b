// SPDX-License-Identifier: GPL-3.0-or-later
// Some other device on the port: sends back every byte, and knows nothing of scanners.
#include <avr/io.h>

int main(void) {
    UBRR0 = F_CPU / 8 / 250000 - 1;
    UCSR0A = _BV(U2X0);
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = _BV(RXEN0) | _BV(TXEN0);
    for (;;) {
        while (!(UCSR0A & _BV(RXC0))) {
        }
        unsigned char byte = UDR0;
        while (!(UCSR0A & _BV(UDRE0))) {
        }
        UDR0 = byte;
    }
}
