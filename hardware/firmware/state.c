/* SPDX-License-Identifier: Apache-2.0 */
#include "state.h"

volatile uint8_t state, fault;
volatile bool fault_unsaid, homed, enabled;
volatile uint32_t clock_ms;
uint16_t current_seq, boot, watchdog_resets;
