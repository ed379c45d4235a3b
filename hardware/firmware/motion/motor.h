/* One run of the motor at a time: a ramp after David Austin on timer 1, to a target or until the switch changes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef MOTOR_H
#define MOTOR_H

#include <stdbool.h>
#include <stdint.h>

enum seek { NOTHING_SOUGHT, UNTIL_ACTIVE, UNTIL_INACTIVE };

/* Main loop, while nothing runs. Goes to `to` at up to `speed` steps/s; slows down earlier if it finds the edge that it seeks. */
void motor_run(int32_t to, uint32_t speed, enum seek sought);
bool motor_running(void);
int32_t motor_position(void);
bool motor_found(int32_t *at);     /* whether the last run found the edge that it sought, and where */
void motor_shift(int32_t origin);  /* at rest: this position is 0 from now on */

/* With interrupts off. After halt or slow nothing runs until it is released. */
bool motor_halt(void); /* no further step; true if it ran faster than vst, and may have run on */
void motor_slow(void); /* down the ramp, then at rest */
void motor_release(void);
bool motor_blocked(void);

#endif
