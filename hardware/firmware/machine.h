/* The functions through which commands reach the hardware: machine.c on the controller, host/fake.c in tests.
 *
 * A function that starts something returns 0, or an error of the protocol; then it has done nothing.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef MACHINE_H
#define MACHINE_H

#include <stdbool.h>
#include <stdint.h>

#include "state.h"

enum { INPUT_HOME = 1, INPUT_ESTOP = 2, INPUT_READY = 4 };

struct machine_status {
    int32_t position; /* microsteps */
    uint16_t lease_ms, exposures;
    uint8_t state, fault, inputs, laser; /* laser: the one that is lit, 0 for none */
    bool homed, armed, enabled;
};

struct machine_counters {
    uint32_t laser, up_ms;
    uint16_t lost_bytes, watchdog_resets;
    int32_t home_was; /* `was` of the last HOMED, since the event may be lost */
};

void machine_status(struct machine_status *status);
void machine_counters(struct machine_counters *counters);
uint16_t machine_boot(void);

void machine_feed(void); /* a good line came: feeds the link watchdog */
uint8_t machine_enable(bool on);
uint8_t machine_arm(bool on);
uint8_t machine_laser(uint8_t number, uint16_t ms); /* lights this one alone */
uint8_t machine_laser_off(void);                    /* all of them */
uint8_t machine_move(uint16_t seq, int32_t to);
uint8_t machine_home(uint16_t seq, uint32_t most);
uint8_t machine_shot(uint16_t seq, const struct shot_order *order);
uint8_t machine_expose(uint16_t seq, uint16_t ms);
uint8_t machine_selftest(uint16_t seq);
uint8_t machine_set(const int32_t *candidate); /* all settings at once */
uint8_t machine_clear(void);
void machine_stop(void);
void machine_session(void); /* a session begins: laser off, contactor open, and a shot ends as by machine_stop */

void machine_write(const char *bytes, uint8_t length);
#ifdef TEST_HANG
void machine_hang(bool without_interrupts);
#endif

#endif
