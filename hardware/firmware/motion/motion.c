/* A motion is one to six runs of the motor, begun one after the other by the main loop.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "motion.h"

#include "motor.h"
#include "pins.h"
#include "settings.h"
#include "state.h"

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

static volatile uint8_t phase;
static int32_t move_to;
static uint32_t home_most;
static volatile uint8_t home_outcome;
static int32_t home_was;

/* Backlash: microsteps upwards since the last motion downwards */
static uint32_t taken_up;
static int32_t leg_start;

static void note_travel(void) {
    int32_t now = motor_position(), gone = now - leg_start;
    leg_start = now;
    if (gone < 0)
        taken_up = 0;
    else if (taken_up < 100000)
        taken_up += (uint32_t)gone;
}

static void leg(int32_t to, uint32_t speed, enum seek sought) {
    note_travel();
    motor_run(to, speed, sought);
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

static void home_take_edge(int32_t edge) {
    motor_shift(edge);
    leg_start -= edge;
    home_was = edge;
}

/* The next leg; each is at its end when this is called. */
static void home_poll(void) {
    uint32_t fast = (uint32_t)settings[VMAX], slow = (uint32_t)settings[HV];
    int32_t here = motor_position(), edge;
    bool found = motor_found(&edge);
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
        leg(plus(edge, CLEARANCE), fast, NOTHING_SOUGHT);
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
        home_take_edge(edge);
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
    if (motor_running() || phase == AT_REST) return;
    if (motor_blocked()) {
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
    motor_release();
    move_to = to;
    phase = MOVE_BEGIN;
}

void motion_begin_home(uint32_t most) {
    motor_release();
    homed = false;
    home_most = most;
    home_outcome = HOME_STOPPED;
    phase = HOME_BEGIN;
}

void motion_halt(void) {
    if (motor_halt()) homed = false; /* The motor may have run on. */
    phase = AT_REST;
}

void motion_slow(void) {
    motor_slow();
}

void motion_forget(void) {
    taken_up = 0;
}

bool motion_busy(void) {
    return phase != AT_REST;
}

int32_t motion_position(void) {
    return motor_position();
}

enum home_outcome motion_home_outcome(void) {
    return home_outcome;
}

int32_t motion_home_was(void) {
    return home_was;
}
