/* SPDX-License-Identifier: Apache-2.0 */
#include "laser.h"

#include "pins.h"

volatile uint32_t laser_switched;
volatile uint16_t laser_lease_ms;

void laser_on(uint8_t number, uint16_t lease_ms) {
    if (!contactor_closed() || !lease_ms) return;
    if (laser_lit() != number) {
        laser_off();
        laser_switched++;
    }
    laser_lease_ms = lease_ms;
    if (number == 1)
        PORTB |= LASER_1;
    else
        PORTB |= LASER_2;
}

void laser_off(void) {
    PORTB &= (uint8_t)~LASERS_ALL;
    laser_lease_ms = 0;
}

uint8_t laser_lit(void) { /* Read from the pins; there is no other record. */
    return PORTB & LASER_1 ? 1 : PORTB & LASER_2 ? 2 : 0;
}

void laser_count_down(void) {
    if (laser_lease_ms) laser_lease_ms--;
}

bool laser_expired(void) {
    return laser_lit() && !laser_lease_ms;
}

void contactor_close(void) {
    PORTD |= CONTACTOR;
}

void contactor_open(void) {
    PORTD &= (uint8_t)~CONTACTOR;
}

bool contactor_closed(void) {
    return (PORTD & CONTACTOR) != 0;
}
