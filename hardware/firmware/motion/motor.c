/* The interrupt makes the step first and computes the next interval afterwards, with interrupts on, so that the serial line
 * loses no byte and steps do not jitter. A run is prepared in the main loop, with interrupts on.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "motor.h"

#include <avr/interrupt.h>
#include <util/atomic.h>

#include "pins.h"
#include "settings.h"

#define TICKS_PER_S 2000000ul /* timer 1 at clock / 8 */
#define START_FACTOR 1912017ul /* 0.676 sqrt(2) ticks/s: Austin's first interval is this over sqrt(acceleration) */

static volatile bool running, blocked, found;
static volatile int32_t position;
static volatile uint32_t left;     /* steps */
static volatile uint32_t ramp;     /* steps that it takes to slow down again */
static volatile uint32_t interval; /* ticks << 8 */
static uint32_t shortest, ramp_base, next_ticks, rest_ticks, slow_ticks;
static int32_t found_at;
static int8_t sense;
static uint8_t seek;

static uint32_t root(uint32_t square) {
    uint32_t result = 0, bit = 1ul << 30;
    while (bit > square)
        bit >>= 2;
    for (; bit; bit >>= 2) {
        if (square >= result + bit) {
            square -= result + bit;
            result = (result >> 1) + bit;
        } else
            result >>= 1;
    }
    return result;
}

static void timer_stop(void) { /* An idle timer costs interrupts on the controller and time in a simulator. */
    TCCR1B = _BV(WGM12);
    TIMSK1 = 0;
    running = false;
}

/* The timer has 16 bits: a longer interval is made of parts, without a step in between. */
static inline void timer_load(uint32_t ticks) {
    if (ticks > 65536) {
        OCR1A = 32767;
        rest_ticks = ticks - 32768;
    } else {
        OCR1A = (uint16_t)(ticks - 1);
        rest_ticks = 0;
    }
}

/* Read by a halt in another interrupt, while the step's own interrupt has interrupts on. */
static void set_interval(uint32_t ticks) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) interval = ticks;
}

/* The interval after the one that is running. */
static void next_interval(uint32_t steps_left) {
    uint32_t now = interval;
    if (steps_left <= ramp + 1) {
        if (ramp) {
            uint32_t share = 4 * ramp - 1 + ramp_base;
            now += (2 * now + share / 2) / share; /* exactly the reverse of the ramp up */
            ramp--;
        }
    } else if (now > shortest) {
        ramp++;
        uint32_t share = 4 * ramp + 1 + ramp_base;
        now -= (2 * now + share / 2) / share; /* Rounded: truncation would make the ramp a twentieth longer. */
        if (now < shortest) now = shortest;
    }
    set_interval(now);
    next_ticks = now >> 8;
}

ISR(TIMER1_COMPA_vect) {
    if (rest_ticks) {
        timer_load(rest_ticks);
        return;
    }
    if (seek && !found && home_active() == (seek == UNTIL_ACTIVE)) {
        found = true;
        found_at = position;
        if (left > ramp) left = ramp;
        if (!left) {
            timer_stop();
            return;
        }
    }
    PORTD |= STEP;
    timer_load(next_ticks);
    position += sense;
    uint32_t steps_left = left - 1;
    left = steps_left;
    if (!steps_left) timer_stop();
    PORTD &= (uint8_t)~STEP; /* 2 us and more after the rising edge */
    if (!steps_left) return;
    TIMSK1 = 0;
    sei();
    next_interval(steps_left);
    cli();
    if (running) TIMSK1 = _BV(OCIE1A);
}

void motor_run(int32_t to, uint32_t speed, enum seek sought) {
    int32_t from = motor_position();
    if (to == from) return;
    uint32_t vst = (uint32_t)settings[VST], acc = (uint32_t)settings[ACC];
    uint32_t start_speed = vst < speed ? vst : speed;
    uint32_t first = TICKS_PER_S / start_speed, from_rest = START_FACTOR * 16 / root(acc << 8);
    uint32_t base = 0;
    if (from_rest < first)
        first = from_rest; /* From rest the ramp's own first step is faster than vst. */
    else
        base = 2 * start_speed * start_speed / acc; /* four times the steps in which a ramp from rest comes to vst */
    uint32_t limit = TICKS_PER_S / speed;
    if (first < limit) first = limit;
    bool up = to > from;
    uint32_t steps = up ? (uint32_t)to - (uint32_t)from : (uint32_t)from - (uint32_t)to;
    sense = up ? 1 : -1; /* The interrupt reads none of these until the timer is started. */
    seek = sought;
    found = false;
    ramp = 0;
    ramp_base = base;
    shortest = limit << 8;
    set_interval(first << 8);
    slow_ticks = TICKS_PER_S / vst;
    next_interval(steps);
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        if (!blocked) {
            left = steps;
            if (up == (settings[DIR_SENSE] != 0))
                PORTD |= DIR;
            else
                PORTD &= (uint8_t)~DIR;
            TCNT1 = 0;
            timer_load(first);
            TIFR1 = _BV(OCF1A);
            TIMSK1 = _BV(OCIE1A);
            TCCR1B = _BV(WGM12) | _BV(CS11);
            running = true;
        }
    }
}

bool motor_halt(void) {
    bool fast = running && (interval >> 8) < slow_ticks;
    timer_stop();
    PORTD &= (uint8_t)~STEP;
    left = 0;
    blocked = true;
    return fast;
}

void motor_slow(void) {
    blocked = true;
    if (left > ramp) left = ramp;
    if (!left && running) timer_stop();
}

void motor_release(void) {
    blocked = false;
}

bool motor_running(void) {
    return running;
}

bool motor_blocked(void) {
    return blocked;
}

int32_t motor_position(void) {
    int32_t now;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) now = position;
    return now;
}

bool motor_found(int32_t *at) {
    *at = found_at;
    return found;
}

void motor_shift(int32_t origin) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) position -= origin;
}
