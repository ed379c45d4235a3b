/* A motion is one to five legs; a leg is one run of the timer. The legs are prepared in the main loop, with interrupts on;
 * the interrupt makes the step first and computes the next interval afterwards, open to other interrupts, so that the serial
 * line loses nothing and steps do not jitter.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "motion.h"

#include <avr/interrupt.h>
#include <util/atomic.h>

#include "pins.h"
#include "settings.h"
#include "watch.h"

#define TICKS_PER_S 2000000ul /* timer 1 at clock / 8 */
#define START_FACTOR 1912017ul /* 0.676 sqrt(2) ticks/s: Austin's first interval is this over sqrt(acceleration) */
#define CLEARANCE 64 /* microsteps above the switch from which the slow approach begins */

enum phase {
    AT_REST,
    MOVE_BEGIN,
    MOVE_BELOW,
    MOVE_TARGET,
    HOME_BEGIN,
    HOME_BACK_OFF,
    HOME_FAST,
    HOME_CLEAR,
    HOME_OFF,
    HOME_SLOW,
    HOME_BELOW
};
enum seek { NOTHING_SOUGHT, UNTIL_ACTIVE, UNTIL_INACTIVE };

static volatile uint8_t phase;
static volatile bool halted; /* no leg may start until the next motion is begun */
static int32_t move_to;
static uint32_t home_most;
static volatile uint8_t home_outcome;
static int32_t home_was;

/* The leg that runs: the interrupt's own */
static volatile int32_t position;
static volatile bool running, found;
static volatile uint32_t left; /* steps */
static volatile uint32_t ramp; /* steps that it takes to slow down again */
static volatile uint32_t interval; /* ticks << 8 */
static uint32_t shortest, ramp_base, next_ticks, rest_ticks, slow_ticks;
static int32_t found_at;
static int8_t sense;
static uint8_t seek;

/* Backlash: microsteps that the table has gone up since it last went down */
static uint32_t taken_up;
static int32_t leg_start;

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

/* The interval after the one that is running. */
static void next_interval(uint32_t steps_left) {
    uint32_t now = interval;
    if (steps_left <= ramp + 1) {
        if (ramp) {
            uint32_t share = 4 * ramp - 1 + ramp_base;
            now += (2 * now + share / 2) / share; /* exactly back what the ramp went up */
            ramp--;
        }
    } else if (now > shortest) {
        ramp++;
        uint32_t share = 4 * ramp + 1 + ramp_base;
        now -= (2 * now + share / 2) / share; /* Rounded: cut off, it would come to speed a twentieth late. */
        if (now < shortest) now = shortest;
    }
    interval = now;
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

static void note_travel(void) {
    int32_t now = motion_position(), gone = now - leg_start;
    leg_start = now;
    if (gone < 0)
        taken_up = 0;
    else if (taken_up < 100000)
        taken_up += (uint32_t)gone;
}

static void leg(int32_t to, uint32_t speed, enum seek sought) {
    note_travel();
    int32_t from = leg_start;
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
    sense = up ? 1 : -1; /* Nothing runs: the interrupt looks at none of these until the timer is started. */
    seek = sought;
    found = false;
    ramp = 0;
    ramp_base = base;
    shortest = limit << 8;
    interval = first << 8;
    slow_ticks = TICKS_PER_S / vst;
    next_interval(steps);
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        if (!halted) {
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

static int32_t minus(int32_t value, uint32_t less) { /* stays a number of 32 bits */
    return (uint32_t)value - (uint32_t)INT32_MIN < less ? INT32_MIN : (int32_t)((uint32_t)value - less);
}

static int32_t plus(int32_t value, uint32_t more) {
    return (uint32_t)INT32_MAX - (uint32_t)value < more ? INT32_MAX : (int32_t)((uint32_t)value + more);
}

static void move_begin(void) {
    note_travel();
    uint32_t back = (uint32_t)settings[BACK];
    int32_t from = leg_start;
    bool below = back && (move_to < from || taken_up + ((uint32_t)move_to - (uint32_t)from) < back);
    phase = below ? MOVE_BELOW : MOVE_TARGET;
    leg(below ? minus(move_to, back) : move_to, (uint32_t)settings[VMAX], NOTHING_SOUGHT);
}

static void home_end(enum home_outcome outcome) {
    home_outcome = outcome;
    phase = AT_REST;
}

static void home_take_edge(void) {
    home_was = found_at;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) position -= found_at;
    leg_start -= found_at;
}

/* The next leg; each is at its end when this is called. */
static void home_poll(void) {
    uint32_t fast = (uint32_t)settings[VMAX], slow = (uint32_t)settings[HV];
    int32_t here = motion_position();
    switch (phase) {
    case HOME_BEGIN:
        if (home_active()) {
            phase = HOME_BACK_OFF;
            leg(plus(here, home_most), fast, UNTIL_INACTIVE);
            break;
        }
        phase = HOME_FAST;
        leg(minus(here, home_most), fast, UNTIL_ACTIVE);
        break;
    case HOME_BACK_OFF:
        if (home_active()) {
            home_end(HOME_MISSED);
            break;
        }
        phase = HOME_FAST;
        leg(minus(here, home_most), fast, UNTIL_ACTIVE);
        break;
    case HOME_FAST:
    case HOME_OFF:
        if (!found) {
            home_end(HOME_MISSED);
            break;
        }
        phase = HOME_CLEAR;
        leg(plus(found_at, CLEARANCE), fast, NOTHING_SOUGHT);
        break;
    case HOME_CLEAR:
        if (home_active()) { /* a switch that lets go later than it closes */
            phase = HOME_OFF;
            leg(plus(here, home_most), slow, UNTIL_INACTIVE);
            break;
        }
        phase = HOME_SLOW;
        leg(minus(here, home_most), slow, UNTIL_ACTIVE);
        break;
    case HOME_SLOW:
        if (!found) {
            home_end(HOME_MISSED);
            break;
        }
        home_take_edge();
        phase = HOME_BELOW;
        leg(-settings[BACK], fast, NOTHING_SOUGHT);
        break;
    default: /* HOME_BELOW: up to the edge again, so that home too is approached from below */
        if (here == 0) {
            home_end(HOME_FOUND);
            break;
        }
        leg(0, fast, NOTHING_SOUGHT);
        break;
    }
}

void motion_poll(void) {
    if (running || phase == AT_REST) return;
    if (halted) {
        phase = AT_REST;
        return;
    }
    switch (phase) {
    case MOVE_BEGIN:
        move_begin();
        break;
    case MOVE_BELOW:
        phase = MOVE_TARGET;
        leg(move_to, (uint32_t)settings[VMAX], NOTHING_SOUGHT);
        break;
    case MOVE_TARGET:
        phase = AT_REST;
        break;
    default:
        home_poll();
        break;
    }
}

void motion_begin_move(int32_t to) {
    halted = false;
    move_to = to;
    phase = MOVE_BEGIN;
}

void motion_begin_home(uint32_t most) {
    halted = false;
    homed = false;
    home_most = most;
    home_outcome = HOME_STOPPED;
    phase = HOME_BEGIN;
}

void motion_halt(void) {
    bool ran = running;
    timer_stop();
    PORTD &= (uint8_t)~STEP;
    if (ran && (interval >> 8) < slow_ticks) homed = false; /* The motor may have run on. */
    left = 0;
    halted = true;
    phase = AT_REST;
}

void motion_slow(void) {
    halted = true;
    if (left > ramp) left = ramp;
    if (!left && running) timer_stop();
}

void motion_forget(void) {
    taken_up = 0;
}

bool motion_busy(void) {
    return phase != AT_REST;
}

int32_t motion_position(void) {
    int32_t now;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) now = position;
    return now;
}

enum home_outcome motion_home_outcome(void) {
    return home_outcome;
}

int32_t motion_home_was(void) {
    return home_was;
}
