/* SPDX-License-Identifier: Apache-2.0 */
#include "machine.h"

#include <avr/interrupt.h>
#include <avr/pgmspace.h>
#include <string.h>
#include <util/atomic.h>

#include "laser.h"
#include "motion.h"
#include "pins.h"
#include "settings.h"
#include "shot.h"
#include "uart.h"
#include "watch.h"

void machine_status(struct machine_status *status) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        status->state = state;
        status->fault = fault;
        status->position = motion_position();
        status->lease_ms = laser_lease_ms;
        status->exposures = exposures;
        status->homed = homed;
        status->armed = contactor_closed();
        status->enabled = enabled;
        status->laser = laser_lit();
        status->inputs = (uint8_t)((home_active() ? INPUT_HOME : 0) | (estop_pressed() ? INPUT_ESTOP : 0) |
                                   (camera_ready() ? INPUT_READY : 0));
    }
}

void machine_counters(struct machine_counters *counters) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        counters->laser = laser_switched;
        counters->up_ms = clock_ms;
        counters->lost_bytes = uart_lost;
    }
    counters->watchdog_resets = watchdog_resets;
    counters->home_was = motion_home_was();
}

uint16_t machine_boot(void) {
    return boot;
}

void machine_feed(void) {
    watch_feed((uint16_t)settings[WD], armed_idle_ms());
}

/* With interrupts off. Checked again, since an interrupt may have come after the check in commands.c. */
static uint8_t still_idle(void) {
    if (estop_pressed() && fault != F_ESTOP) fault_enter(F_ESTOP);
    if (state == FAULTED) return 6;
    return state == IDLE ? 0 : 5;
}

uint8_t machine_enable(bool on) {
    uint8_t refusal;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        refusal = still_idle();
        if (!refusal) driver_switch(on);
    }
    return refusal;
}

uint8_t machine_arm(bool on) {
    uint8_t refusal = 0;
    if (!on) {
        machine_laser_off();
        ATOMIC_BLOCK(ATOMIC_RESTORESTATE) contactor_open();
        return 0;
    }
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        refusal = still_idle();
        if (!refusal) contactor_close();
    }
    return refusal;
}

uint8_t machine_laser(uint8_t number, uint16_t ms) {
    uint8_t refusal = 0;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        if (state == FAULTED)
            refusal = 6;
        else
            laser_on(number, ms);
    }
    return refusal;
}

uint8_t machine_laser_off(void) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        laser_off();
        if (state == SHOOTING && shot_kind == A_SHOT) machine_stop(); /* Its lit exposure would be dark. */
    }
    return 0;
}

uint8_t machine_move(uint16_t seq, int32_t to) {
    uint8_t refusal;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        refusal = still_idle();
        if (!refusal) {
            state = MOVING;
            current_seq = seq;
            motion_begin_move(to);
        }
    }
    return refusal;
}

uint8_t machine_home(uint16_t seq, uint32_t most) {
    uint8_t refusal;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        refusal = still_idle();
        if (!refusal) {
            laser_off();
            state = HOMING;
            current_seq = seq;
            motion_begin_home(most);
        }
    }
    return refusal;
}

uint8_t machine_shot(uint16_t seq, const struct shot_order *order) {
    uint8_t refusal;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        refusal = still_idle();
        if (!refusal) {
            state = SHOOTING;
            current_seq = seq;
            motion_begin_move(order->to);
            shot_begin(order);
        }
    }
    return refusal;
}

uint8_t machine_expose(uint16_t seq, uint16_t ms) {
    uint8_t refusal;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        refusal = still_idle();
        if (!refusal) {
            state = SHOOTING;
            current_seq = seq;
            expose_begin(ms);
        }
    }
    return refusal;
}

uint8_t machine_selftest(uint16_t seq) {
    uint8_t refusal;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        refusal = still_idle();
        if (!refusal) {
            laser_off();
            state = SHOOTING;
            current_seq = seq;
            test_begin();
        }
    }
    return refusal;
}

uint8_t machine_set(const int32_t *candidate) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        if (candidate[DIR_SENSE] != settings[DIR_SENSE]) { /* Up and down are exchanged. */
            homed = false;
            motion_forget();
        }
        memcpy(settings, candidate, sizeof settings);
    }
    machine_feed(); /* with the new wd */
    return 0;
}

uint8_t machine_clear(void) {
    uint8_t refusal = 0;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        if (estop_pressed() || fault_unsaid) /* The line must not clear a fault newer than itself. */
            refusal = 6;
        else if (state == FAULTED) {
            state = IDLE;
            fault = NO_FAULT;
        }
    }
    return refusal;
}

void machine_stop(void) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        laser_off();
        if (state == MOVING || state == HOMING || state == SHOOTING) {
            shot_cancel();
            motion_slow();
            state = MOVING; /* ends with DONE as soon as it is at rest */
        }
    }
}

void machine_session(void) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        laser_off();
        contactor_open();
        if (state == SHOOTING) machine_stop();
    }
}

void machine_write(const char *bytes, uint8_t length) {
    uart_send(bytes, length);
}

#ifdef TEST_HANG
void machine_hang(bool without_interrupts) {
    if (without_interrupts) cli();
    for (;;) {}
}
#endif
