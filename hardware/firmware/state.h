/* The state that all parts share, and the words for it. It knows no other part.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef STATE_H
#define STATE_H

#include <stdbool.h>
#include <stdint.h>

#define LEASE_MS 1000u
#define LASERS 2 /* numbered from 1; one at most is lit */
#define ARMED_IDLE_MS 10000u /* without a good line, after which the contactor opens while nothing runs */

enum state { IDLE, MOVING, HOMING, SHOOTING, FAULTED };
enum fault { NO_FAULT, F_ESTOP, F_LINK, F_LEASE, F_HOME, F_ABORT, F_CAMERA };
enum { LIT = 1, DARK = 2 };

struct shot_order {
    int32_t to;
    uint32_t id;
    uint8_t modes; /* LIT, DARK */
    uint8_t laser; /* of the lit exposure */
};

extern volatile uint8_t state, fault;
extern volatile bool fault_unsaid; /* a fault whose event is not sent yet */
extern volatile bool homed, enabled;
extern volatile uint32_t clock_ms;
extern uint16_t current_seq;           /* of the command that is being carried out */
extern uint16_t boot, watchdog_resets; /* counts that survive a reset */

#endif
