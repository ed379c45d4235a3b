/* SPDX-License-Identifier: Apache-2.0 */
#include "report.h"

#include <avr/eeprom.h>
#include <avr/io.h>
#include <avr/pgmspace.h>
#include <stddef.h>
#include <util/atomic.h>

#include "commands.h"
#include "motion.h"
#include "shot.h"
#include "watch.h"

#define BOOTS ((uint16_t *)0)           /* addresses in the EEPROM */
#define WATCHDOG_RESETS ((uint16_t *)2) /* erased cells read 65535: none yet */

static uint16_t counted(uint16_t *cell, bool one_more) {
    uint16_t count = eeprom_read_word(cell);
    if (count == UINT16_MAX) count = 0;
    if (one_more) eeprom_update_word(cell, ++count);
    return count;
}

void report_begin(uint8_t reset_cause) {
    boot = counted(BOOTS, true);
    watchdog_resets = counted(WATCHDOG_RESETS, reset_cause & _BV(WDRF));
    struct event event = {PSTR("BOOT"), PSTR("why"), PSTR("boot"), NULL, reset_cause, boot, 0};
    commands_event(&event);
}

bool report_pending(void) {
    return fault_unsaid;
}

/* Back to idle, unless a fault came first, which is then sent instead. */
static bool ended(uint8_t in_state) {
    bool idle = false;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) if (state == in_state) {
        state = IDLE;
        idle = true;
    }
    return idle;
}

static void say_fault(void) {
    struct event event = {PSTR("FAULT"), PSTR("f"), PSTR("pos"), NULL, 0, 0, 0};
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        fault_unsaid = false;
        event.first_value = fault;
        event.second_value = motion_position();
    }
    commands_event(&event);
}

static void say_homed(void) {
    if (motion_home_outcome() != HOME_FOUND) {
        ATOMIC_BLOCK(ATOMIC_RESTORESTATE) if (state == HOMING) fault_enter(F_HOME);
        return;
    }
    bool good = false;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) if (state == HOMING) {
        state = IDLE;
        homed = good = true;
    }
    if (!good) return;
    struct event event = {PSTR("HOMED"), PSTR("seq"), PSTR("was"), NULL, current_seq, motion_home_was(), 0};
    commands_event(&event);
}

static void say_done(void) {
    struct event event = {PSTR("DONE"), PSTR("seq"), PSTR("pos"), NULL, current_seq, motion_position(), 0};
    if (ended(MOVING)) commands_event(&event);
}

static void say_shot(void) {
    struct event event = {PSTR("SHOT"), PSTR("id"), PSTR("pos"), PSTR("trg"), shot_id, motion_position(), exposures};
    if (shot_kind == A_TEST) {
        event.name = PSTR("TESTED");
        event.first = PSTR("seq");
        event.second = event.third = NULL;
        event.first_value = current_seq;
    }
    if (ended(SHOOTING) && shot_kind != AN_EXPOSURE) commands_event(&event);
}

void report_poll(void) {
    if (fault_unsaid) say_fault();
    if (motion_busy()) return;
    switch (state) {
    case MOVING:
        say_done();
        break;
    case HOMING:
        say_homed();
        break;
    case SHOOTING:
        if (!shot_running()) say_shot();
        break;
    default:
        break;
    }
}
