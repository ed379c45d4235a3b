/* Faults, the e-stop, the link watchdog, the processor's watchdog, and their common clock.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef WATCH_H
#define WATCH_H

#include <stdbool.h>
#include <stdint.h>

#include "state.h"

uint8_t watch_begin(void); /* first thing in main; returns why the processor was reset (MCUSR) */
void watch_start_clock(void);
void watch_loop_lives(void); /* called by the main loop */
void watch_feed(uint16_t ms, uint16_t idle_ms); /* until the link counts as lost; until the contactor opens at rest */

/* With interrupts off. The e-stop overrides every fault, an abort all but that, the others none. */
void fault_enter(enum fault which);

void driver_switch(bool on);

#endif
