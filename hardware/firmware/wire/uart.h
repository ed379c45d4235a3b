/* The serial line: 250000 baud, interrupt driven both ways.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef UART_H
#define UART_H

#include <stdbool.h>
#include <stdint.h>

extern volatile uint16_t uart_lost; /* bytes received and lost */

void uart_begin(void);
bool uart_waiting(void);          /* with interrupts off: is there a byte to take */
int16_t uart_take(void);          /* the next byte, -1: none */
void uart_send(const char *bytes, uint8_t length); /* waits while the buffer is full */

#endif
