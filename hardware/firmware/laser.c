/* SPDX-License-Identifier: Apache-2.0 */
#include "laser.h"

#include "pins.h"

volatile uint32_t laser_switched;
volatile uint16_t laser_lease_ms;

void laser_on(uint16_t lease_ms) {
    if (!contactor_closed() || !lease_ms) return;
    if (!laser_is_on()) laser_switched++;
    laser_lease_ms = lease_ms;
    PORTB |= LASER;
}

void laser_off(void) {
    PORTB &= (uint8_t)~LASER;
    laser_lease_ms = 0;
}

bool laser_is_on(void) {
    return (PORTB & LASER) != 0; /* The pin itself: nothing else remembers. */
}

void laser_count_down(void) {
    if (laser_lease_ms) laser_lease_ms--;
}

bool laser_expired(void) {
    return laser_is_on() && !laser_lease_ms;
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
