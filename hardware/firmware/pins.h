/* Pins of the controller, those of a CNC shield on an Arduino Uno where it has one.
 *
 * ESTOP  PD3 / INT1, pull-up. HIGH = pressed or wire broken, LOW = all is well: a normally closed contact to ground.
 * HOME_N PB1, pull-up. LOW = switch active.
 * RDY    PC0, no pull-up (external pull-down). HIGH = the camera is ready for a trigger.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef PINS_H
#define PINS_H

#include <avr/io.h>

/* outputs */
#define EN_N _BV(PB0)      /* port B: driver, low = enabled */
#define LASER_1 _BV(PB3)   /* port B: gate of the first laser's MOSFET */
#define LASER_2 _BV(PB2)   /* port B: gate of the second laser's MOSFET */
#define TRIG _BV(PB4)      /* port B: camera trigger, through an optocoupler */
#define LED _BV(PB5)       /* port B: lit while armed, blinks in a fault */
#define LASERS_ALL (LASER_1 | LASER_2) /* of one port: a single instruction puts them off */
#define STEP _BV(PD2)      /* port D: a rising edge is a microstep */
#define CONTACTOR _BV(PD4) /* port D: coil of the lasers' safety contactor, high = closed */
#define DIR _BV(PD5)       /* port D: high = downwards, with dir=0 */

/* inputs */
#define HOME_N _BV(PB1) /* port B */
#define ESTOP _BV(PD3)  /* port D */
#define RDY _BV(PC0)    /* port C */

static inline uint8_t home_active(void) {
    return !(PINB & HOME_N);
}
static inline uint8_t estop_pressed(void) {
    return (PIND & ESTOP) != 0;
}
static inline uint8_t camera_ready(void) {
    return (PINC & RDY) != 0;
}

#endif
