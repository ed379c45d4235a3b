/* SPDX-License-Identifier: Apache-2.0 */
#include "shot.h"

#include "laser.h"
#include "motion.h"
#include "pins.h"
#include "settings.h"

#define TEST_MS 100

enum phase {
    OVER,
    TRAVEL,
    SETTLING,
    WARMING,
    READY_LIT,
    EXPOSING_LIT,
    GAP_LIT,
    DARKENING,
    READY_DARK,
    EXPOSING_DARK,
    GAP_DARK,
    BEFORE_EXPOSURE,
    EXPOSING,
    BEFORE_TEST,
    TEST_LED,
    TEST_TRIGGER,
    TEST_DRIVER
};

volatile uint16_t exposures;
volatile uint8_t shot_kind;
volatile uint32_t shot_id;
static volatile uint8_t phase;
static uint8_t modes, laser;
static uint16_t left_ms, single_ms;

static void enter(uint8_t next, uint16_t ms) {
    phase = next;
    left_ms = ms;
}

static void trigger(uint8_t next, uint16_t ms) {
    PORTB |= TRIG;
    exposures++;
    enter(next, ms);
}

static uint16_t setting(enum setting which) {
    return (uint16_t)settings[which];
}

static void after_settling(void) {
    if (modes & LIT) {
        laser_on(laser, setting(LON) + setting(RDY_WAIT) + setting(EXP) + setting(GAP));
        enter(WARMING, setting(LON));
    } else
        enter(DARKENING, setting(LOFF));
}

static void advance(void) {
    switch (phase) {
    case TRAVEL:
        enter(SETTLING, setting(SETTL));
        break;
    case SETTLING:
        after_settling();
        break;
    case WARMING: /* Without a wait it goes on at once, so that the edge is not late in its tick. */
        if (settings[RDY_WAIT]) {
            enter(READY_LIT, setting(RDY_WAIT));
            break;
        } /* fall through */
    case READY_LIT:
        trigger(EXPOSING_LIT, setting(EXP));
        break;
    case EXPOSING_LIT:
        PORTB &= (uint8_t)~TRIG;
        enter(GAP_LIT, setting(GAP));
        break;
    case GAP_LIT:
        laser_off();
        if (modes & DARK)
            enter(DARKENING, setting(LOFF));
        else
            enter(OVER, 0);
        break;
    case DARKENING:
        if (settings[RDY_WAIT]) {
            enter(READY_DARK, setting(RDY_WAIT));
            break;
        } /* fall through */
    case READY_DARK:
        trigger(EXPOSING_DARK, setting(EXP));
        break;
    case EXPOSING_DARK:
        PORTB &= (uint8_t)~TRIG;
        enter(GAP_DARK, setting(GAP));
        break;
    case BEFORE_EXPOSURE:
        trigger(EXPOSING, single_ms);
        break;
    case EXPOSING:
        PORTB &= (uint8_t)~TRIG;
        enter(OVER, 0);
        break;
    case BEFORE_TEST:
        PORTB |= LED;
        enter(TEST_LED, TEST_MS);
        break;
    case TEST_LED:
        PORTB &= (uint8_t)~LED;
        trigger(TEST_TRIGGER, TEST_MS); /* The camera sees it, so it counts. */
        break;
    case TEST_TRIGGER:
        PORTB &= (uint8_t) ~(TRIG | EN_N);
        enter(TEST_DRIVER, TEST_MS);
        break;
    case TEST_DRIVER:
        if (!enabled) PORTB |= EN_N;
        enter(OVER, 0);
        break;
    default: /* GAP_DARK */
        enter(OVER, 0);
        break;
    }
}

static bool readying(void) {
    return phase == READY_LIT || phase == READY_DARK;
}

/* Whether the phase may end now, without waiting for a tick. */
static bool passes(void) {
    if (phase == OVER) return false;
    return !left_ms || (readying() && camera_ready());
}

bool shot_tick(void) {
    if (phase == OVER) return true;
    if (phase == TRAVEL && motion_busy()) return true;
    if (readying()) { /* Entered only with a time to wait; left when the camera is ready or the time is over. */
        if (!camera_ready()) return --left_ms != 0;
    } else if (left_ms && --left_ms)
        return true;
    do
        advance();
    while (passes());
    return true;
}

void shot_begin(const struct shot_order *order) {
    laser_off(); /* A lease from LASER must not light the dark exposure or another laser's exposure. */
    shot_kind = A_SHOT;
    shot_id = order->id;
    modes = order->modes;
    laser = order->laser;
    enter(TRAVEL, 0);
}

void expose_begin(uint16_t ms) {
    shot_kind = AN_EXPOSURE;
    single_ms = ms;
    enter(BEFORE_EXPOSURE, 0);
}

void test_begin(void) {
    shot_kind = A_TEST;
    enter(BEFORE_TEST, 0);
}

void shot_cancel(void) {
    PORTB &= (uint8_t)~TRIG;
    if (phase >= BEFORE_TEST) {
        PORTB &= (uint8_t)~LED;
        if (!enabled) PORTB |= EN_N;
    }
    enter(OVER, 0);
}

bool shot_running(void) {
    return phase != OVER;
}

bool shot_testing(void) {
    return phase >= BEFORE_TEST;
}
